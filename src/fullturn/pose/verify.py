"""What tells a right pose from a wrong one, measured on both clouds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.geometry.neighbors import NeighborIndex, gather
from fullturn.pose.levels import Level, LevelPair
from fullturn.pose.visibility import DepthImage

# MEASURED is what `measure` gives for each pose. All are averages of the two directions, then, for
# the ones in _SIDED, how far the two directions differ. h is the point spacing, d the distance to
# the nearest point of the other cloud; "near" means d < 1.5 h.
_LOGARITHMIC = (
    "distance_half",  # mean of min(d/h, 0.5)²
    "distance_one",  # mean of min(d/h, 1)²
    "distance_two",  # mean of min(d/h, 2)²
    "plane",  # near: mean of min(height/h, 1)², height above the partner's tangent plane
    "smooth_tight",  # near: as plane, between smoothed points, capped at 0.15
    "smooth_half",  # ... at 0.5
    "smooth_one",  # ... at 1
)
_LINEAR = (
    "normals",  # near: mean of 1 − |cos| of the two normals
    "overlap",  # share of points that are near
    "overlap_tight",  # share with d < h and smoothed height < 0.2 h
    "split",  # share that is near but more than 0.5 h apart across the surface
    "conflict_low",  # share that hangs 1.5 h to 0.05 over the inside of the other surface
    "conflict_middle",  # ... 0.05 to 0.1
    "conflict_high",  # ... 0.1 to 0.25
    # Two views of a shape that is alike in front and behind fit best as if from one side: with
    # their rims on each other.
    "rims",  # of near points on a rim: share whose partner lies on one, too
)
_SIDED = ("distance_half", "distance_two", "plane", "smooth_half", "overlap", "conflict_middle")
_SEEN = (
    "sight_blocked",  # share of points in front of the surface that a known sensor saw
    "sight_empty",  # share where that sensor saw nothing at all
    "sight_outside",  # share beside all that it saw, where it may not have looked
    "sight_known",  # share of the two sensors whose place is known
)
_SIDES = ("same_side",)  # cosine between the mean normals of the two clouds
_PAIR = (
    "one_sided",  # length of the mean normals: 1 of a flat side, 0 of what is seen all around
    "log_points",  # of the smaller cloud, natural logarithm
)
# Of keypoints that are near, by the descriptor network; NaN where there is none.
AGREEMENT = (
    "alike",  # mean similarity of a point and its partner
    "unlike",  # mean of how much more alike the most similar point of the other cloud is
)
_CONFLICT_REACH = 0.25  # normalized
_TOGETHER = 2.0  # spacings: keypoints lie farther apart than points
_RAW = _LOGARITHMIC + _LINEAR
MEASURED = _RAW + tuple(f"{name}_sides" for name in _SIDED) + _SEEN + _SIDES + _PAIR
FEATURES = MEASURED + AGREEMENT


@dataclass(frozen=True, eq=False)
class Surface:
    """A cloud prepared for verification."""

    points: Float[Tensor, "n 3"]
    normals: Float[Tensor, "n 3"]
    area: Float[Tensor, " n"]  # that each point stands for, 1 on average: all means count it
    smooth: Float[Tensor, "n 3"]  # moved along the normal into the mean plane of the neighbors
    interior: Bool[Tensor, " n"]  # False on the rim of a partial cloud
    index: NeighborIndex
    image: DepthImage | None  # what the sensor saw, where its place is known


def prepare_surface(
    level: Level, *, spacing: float, viewpoint: Float[Tensor, "3"] | None, neighbors: int = 12
) -> Surface:
    """The cloud with its k-d tree, its smoothed points, its rim and its depth image.

    On the rim all neighbors lie on one side: their mean is off by more than 0.35 of their mean
    distance, along the surface.
    """
    points, normals = level.points, level.normals
    index = NeighborIndex(points)
    neighbor, _ = index.knn(points, min(neighbors, len(points)))
    offset = gather(points, neighbor) - points[:, None]
    height = (offset * normals[:, None]).sum(-1, keepdim=True)
    along = offset - height * normals[:, None]
    interior = along.mean(1).norm(dim=-1) < 0.35 * along.norm(dim=-1).mean(1)
    smooth = points + height.mean(1) * normals
    image = None
    if viewpoint is not None:
        image = DepthImage(points, viewpoint.to(points.dtype), spacing=spacing)
    return Surface(points, normals, level.area, smooth, interior, index, image)


def measure(
    T_target_source: Float[Tensor, "k 4 4"], source: Surface, target: Surface, *, spacing: float
) -> Float[Tensor, "k f"]:
    """One row of `MEASURED` per pose; lengths are normalized (`Cloud`), `spacing` is h."""
    R, t = T_target_source[:, :3, :3], T_target_source[:, None, :3, 3]
    there = source.points @ R.mT + t
    back = (target.points - t) @ R
    forward = _one_side(
        there, source.smooth @ R.mT + t, source.normals @ R.mT, source, target, spacing
    )
    backward = _one_side(back, (target.smooth - t) @ R, target.normals @ R, target, source, spacing)
    sided = [_RAW.index(name) for name in _SIDED]
    seen = torch.zeros_like(forward[:, : len(_SEEN)])
    for image, points in ((target.image, there), (source.image, back)):
        if image is not None:
            seen[:, :-1] += image.violations(points) / 2
            seen[:, -1] += 0.5
    differences = (forward - backward)[:, sided].abs()
    of_source, of_target = (
        (side.area @ side.normals) / side.area.sum() for side in (source, target)
    )
    same_side = torch.cosine_similarity(R @ of_source, of_target[None])
    one_sided = float(of_source.norm() + of_target.norm()) / 2
    fewest = min(len(source.points), len(target.points))
    pair = seen.new_tensor([one_sided, math.log(fewest)]).expand(len(seen), -1)
    return torch.cat([(forward + backward) / 2, differences, seen, same_side[:, None], pair], 1)


def agreement(
    T_target_source: Float[Tensor, "k 4 4"], pair: LevelPair, alike: Float[Tensor, "n m"] | None
) -> Float[Tensor, "k 2"]:
    """Whether keypoints that a pose brings together are alike: the last columns of `FEATURES`.

    `alike` says how similar any two keypoints are.
    """
    k = len(T_target_source)
    if alike is None:
        return T_target_source.new_full((k, len(AGREEMENT)), math.nan)
    source, target = pair.source, pair.target
    moved = rigid.apply(T_target_source, source.points[source.keypoints])
    there = target.points[target.keypoints]
    # |a − b|² − |a|²: exact enough for neighbors, and much faster than the distances.
    distance_sq = torch.baddbmm(there.square().sum(-1), moved, there.T.expand(k, -1, -1), alpha=-2)
    distance_sq += moved.square().sum(-1, keepdim=True)
    sums = T_target_source.new_zeros(k, 3)
    for level, dim, similarity in ((source, 2, alike), (target, 1, alike.T)):
        nearest, partner = distance_sq.min(dim)
        weight = level.area[level.keypoints] * (nearest < (_TOGETHER * pair.spacing) ** 2)
        found = similarity.gather(1, partner.T).T
        most = similarity.amax(1)
        sums += torch.stack(
            [(weight * found).sum(-1), (weight * (most - found)).sum(-1), weight.sum(-1)], -1
        )
    return sums[:, :2] / sums[:, 2:].clamp_min(1.0)


def _one_side(
    points: Float[Tensor, "k n 3"],
    smooth: Float[Tensor, "k n 3"],
    normals: Float[Tensor, "k n 3"],
    own: Surface,
    other: Surface,
    h: float,
) -> Float[Tensor, "k f"]:
    """The raw features of points moved onto the other surface, in the order of `_RAW`."""
    partner, distance = other.index.nearest(points.reshape(-1, 3))
    partner, distance = partner.view(points.shape[:2]), distance.view(points.shape[:2])
    partner_normals = other.normals[partner]
    height = ((points - other.points[partner]) * partner_normals).sum(-1).abs()
    smooth_height = ((smooth - other.smooth[partner]) * partner_normals).sum(-1).abs() / h
    cosine = (normals * partner_normals).sum(-1).abs()
    d = distance / h
    weight = own.area / own.area.sum()
    near = (d < 1.5).to(d.dtype)
    least = 1.0 / len(weight)
    near_total = (near @ weight).clamp_min(least)

    def near_mean(value: Tensor) -> Tensor:
        return (value * near) @ weight / near_total

    def share(mask: Tensor) -> Tensor:
        return mask.to(d.dtype) @ weight

    logarithmic = [d.clamp_max(cap).square() @ weight for cap in (0.5, 1.0, 2.0)]
    logarithmic.append(near_mean((height / h).clamp_max(1).square()))
    logarithmic += [near_mean(smooth_height.clamp_max(cap).square()) for cap in (0.15, 0.5, 1.0)]
    # Over the inside, not beyond the rim, and above it rather than beside it: a surface should
    # have been seen there.
    over_inside = other.interior[partner]
    hangs = over_inside & (height > 0.5 * distance) & (d > 1.5)
    near_rim = (d < 1.5) & ~own.interior
    linear = [
        near_mean(1 - cosine),
        share(d < 1.5),
        share((d < 1) & (smooth_height < 0.2)),
        share((d < 1.5) & (smooth_height > 0.5)),
        share(hangs & (distance <= 0.05)),
        share(hangs & (distance > 0.05) & (distance <= 0.1)),
        share(hangs & (distance > 0.1) & (distance <= _CONFLICT_REACH)),
        share(near_rim & ~over_inside) / share(near_rim).clamp_min(least),
    ]
    return torch.cat([(torch.stack(logarithmic, -1) + 1e-6).log(), torch.stack(linear, -1)], -1)
