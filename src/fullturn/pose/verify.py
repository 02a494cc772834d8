"""What tells a right pose from a wrong one, measured on both clouds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.pose.contact import NEAR, Contact
from fullturn.pose.levels import LevelPair

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
_POSES_AT_ONCE = 4  # whose distances between keypoints then stay in the processor's cache
_RAW = _LOGARITHMIC + _LINEAR
MEASURED = _RAW + tuple(f"{name}_sides" for name in _SIDED) + _SEEN + _SIDES + _PAIR
# By the evidence network, from all keypoints together; NaN likewise.
EVIDENCE = ("evidence",)
FEATURES = MEASURED + AGREEMENT + EVIDENCE
FINE = len(_LOGARITHMIC)  # so many of them, the first, are logarithms


def measure(contacts: tuple[Contact, Contact], *, spacing: float) -> Float[Tensor, "k f"]:
    """One row of `MEASURED` per pose; lengths are normalized (`Cloud`), `spacing` is h."""
    there, back = contacts
    forward, backward = (_one_side(contact, spacing) for contact in contacts)
    sided = [_RAW.index(name) for name in _SIDED]
    seen = torch.zeros_like(forward[:, : len(_SEEN)])
    for contact in contacts:
        image = contact.other.image
        if image is not None:
            seen[:, :-1] += image.violations(contact.points)[0] / 2
            seen[:, -1] += 0.5
    differences = (forward - backward)[:, sided].abs()
    source, target = there.own, back.own
    of_source = (there.normals.mT @ source.area) / source.area.sum()
    same_side = torch.cosine_similarity(of_source, target.facing[None])
    one_sided = float(source.facing.norm() + target.facing.norm()) / 2
    fewest = min(len(source.points), len(target.points))
    pair = seen.new_tensor([one_sided, math.log(fewest)]).expand(len(seen), -1)
    return torch.cat([(forward + backward) / 2, differences, seen, same_side[:, None], pair], 1)


@dataclass(frozen=True, eq=False)
class Likeness:
    """How alike the keypoints of one cloud are to those that k poses lay them next to."""

    distance: Float[Tensor, "k n"]
    found: Float[Tensor, "k n"]  # similarity to the nearest keypoint of the other cloud
    most: Float[Tensor, " n"]  # … to the most similar one, wherever it is
    area: Float[Tensor, " n"]


def likenesses(
    T_target_source: Float[Tensor, "k 4 4"], pair: LevelPair, alike: Float[Tensor, "n m"]
) -> tuple[Likeness, Likeness]:
    """Of the source's keypoints and of the target's; `alike` says how similar any two are."""
    source, target = pair.source, pair.target
    moved = rigid.apply(T_target_source, source.points[source.keypoints])
    there = target.points[target.keypoints].expand(len(moved), -1, -1)
    sides = []
    for level, at, others, similarity in (
        (source, moved, there, alike),
        (target, there, moved, alike.T),
    ):
        distance, partner = _nearest(at, others)
        found = similarity.gather(1, partner.T).T
        area = level.area[level.keypoints]
        sides.append(Likeness(distance, found, similarity.amax(1), area))
    return sides[0], sides[1]


def _nearest(
    at: Float[Tensor, "k n 3"], others: Float[Tensor, "k m 3"]
) -> tuple[Float[Tensor, "k n"], Int[Tensor, "k n"]]:
    """Distance to the nearest of the others, and which one that is."""
    least_sq, nearest = [], []
    for some, those in zip(at.split(_POSES_AT_ONCE), others.split(_POSES_AT_ONCE), strict=True):
        # |a − b|² − |a|²: exact enough for neighbors, and much faster than the distances.
        beyond_sq = torch.baddbmm(those.square().sum(-1).unsqueeze(1), some, those.mT, alpha=-2)
        if beyond_sq.device.type == "cpu":
            nearest.append(torch.from_numpy(beyond_sq.numpy().argmin(-1)))  # six times as fast
        else:
            nearest.append(beyond_sq.argmin(-1))
        least_sq.append(beyond_sq.gather(-1, nearest[-1].unsqueeze(-1)).squeeze(-1))
    distance = (torch.cat(least_sq) + at.square().sum(-1)).clamp_min_(0).sqrt_()
    return distance, torch.cat(nearest)


def agreement(sides: tuple[Likeness, Likeness], *, spacing: float) -> Float[Tensor, "k 2"]:
    """Whether keypoints that a pose brings together are alike: columns `AGREEMENT`."""
    sums = torch.zeros(())
    for side in sides:
        weight = side.area * (side.distance < _TOGETHER * spacing)
        parts = (weight * side.found, weight * (side.most - side.found), weight)
        sums = sums + torch.stack([part.sum(-1) for part in parts], -1)
    return sums[:, :2] / sums[:, 2:].clamp_min(1.0)


def _one_side(contact: Contact, h: float) -> Float[Tensor, "k f"]:
    """The raw features of one cloud laid on the other, in the order of `_RAW`."""
    own = contact.own
    height, smooth_height = contact.height.abs(), contact.smooth_height.abs() / h
    d = contact.distance / h
    weight = own.area / own.area.sum()
    near = (d < NEAR).to(d.dtype)
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
    distance, interior = contact.distance, contact.own.interior
    over_inside = contact.other.interior[contact.partner]
    hangs = over_inside & (height > 0.5 * distance) & (d > NEAR)
    near_rim = (d < NEAR) & ~interior
    linear = [
        near_mean(1 - contact.cosine.abs()),
        share(d < NEAR),
        share((d < 1) & (smooth_height < 0.2)),
        share((d < NEAR) & (smooth_height > 0.5)),
        share(hangs & (distance <= 0.05)),
        share(hangs & (distance > 0.05) & (distance <= 0.1)),
        share(hangs & (distance > 0.1) & (distance <= _CONFLICT_REACH)),
        share(near_rim & ~over_inside) / share(near_rim).clamp_min(least),
    ]
    return torch.cat([(torch.stack(logarithmic, -1) + 1e-6).log(), torch.stack(linear, -1)], -1)
