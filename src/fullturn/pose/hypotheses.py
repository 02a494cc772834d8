"""From candidate matches to distinct poses worth refining."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from fullturn.geometry.step import unit_step
from fullturn.matching.correspondence import Matches
from fullturn.pose.grid import NearestGrid
from fullturn.pose.kabsch import weighted_kabsch
from fullturn.pose.planes import move_planes, squared_falloff, turn_planes

# Poses scored at once: their transformed points then stay in the processor's cache.
_POSES_AT_ONCE = 128
_ANGLE_TOLERANCE = 0.4  # of two normals, in |cosine|
_COMPATIBLE = 0.3  # agreement from which two matches share a motion
_COUNTED = 5  # one in so many matches counts for the agreement of two others


@dataclass(frozen=True, eq=False)
class MatchedPoints:
    """Points, with normals, that candidate matches bring together; row k is match k."""

    source: Float[Tensor, "k 3"]
    target: Float[Tensor, "k 3"]
    source_normals: Float[Tensor, "k 3"]
    target_normals: Float[Tensor, "k 3"]
    source_index: Int[Tensor, " k"]  # which point of the source a match is of

    @classmethod
    def of(
        cls,
        matches: Matches,
        source: Float[Tensor, "n 3"],
        target: Float[Tensor, "m 3"],
        source_normals: Float[Tensor, "n 3"],
        target_normals: Float[Tensor, "m 3"],
    ) -> MatchedPoints:
        return cls(
            source[matches.source],
            target[matches.target],
            source_normals[matches.source],
            target_normals[matches.target],
            matches.source,
        )


def compatibility(
    matched: MatchedPoints,
    *,
    length_tolerance: float,
    max_rotation_rad: float | None = None,
) -> Float[Tensor, "k k"]:
    """How well any two matches agree on one rigid motion, in [0, 1].

    A rigid motion keeps the distance of two points and the angle of their normals (up to sign).
    Agreement falls off as 1 − (difference/tolerance)², the tolerance being 0.4 in |cosine|. Two
    matches closer together than `length_tolerance` say nothing about rotation and get 0, and so do
    two whose motion turns the line between them by more than `max_rotation_rad`.
    """
    at, to = matched.source, matched.target
    source_length, target_length = torch.cdist(at, at), torch.cdist(to, to)
    allowed = unit_step(torch.minimum(source_length, target_length).sub_(length_tolerance))
    if max_rotation_rad is not None:
        products = at @ to.T
        own = products.diagonal()
        cosine = (own[:, None] + own - products - products.T).div_(source_length * target_length)
        allowed *= cosine >= math.cos(min(max_rotation_rad, math.pi))
    agreement = _falloff(source_length - target_length, length_tolerance)
    source_cosine = (matched.source_normals @ matched.source_normals.T).abs_()
    target_cosine = (matched.target_normals @ matched.target_normals.T).abs_()
    agreement *= _falloff(source_cosine - target_cosine, _ANGLE_TOLERANCE)
    return agreement.mul_(allowed)


def seeded_poses(
    matched: MatchedPoints, agreement: Float[Tensor, "k k"], *, companions: int
) -> Float[Tensor, "k 4 4"]:
    """One pose per match: the best rigid motion of the match and the companions it has most with.

    Second-order agreement counts, for two compatible matches, the matches compatible with both
    (Chen et al., "SC²-PCR", CVPR 2022): right matches share many, wrong ones few, which finds
    consistent sets even where most matches are wrong and several modes exist side by side. One
    match in five is counted: it finds as much.
    """
    count = len(matched.source)
    compatible = unit_step(agreement[::_COUNTED] - _COMPATIBLE)
    second_order = (compatible.T @ compatible).mul_(agreement)
    weight, companion = second_order.topk(min(companions, count), dim=1)
    seed = torch.arange(count, device=companion.device)[:, None]
    members = torch.cat([seed, companion], 1)
    weights = torch.cat([weight[:, :1], weight], 1)
    return weighted_kabsch(
        matched.source[members], matched.target[members], weights.clamp_min(1e-6)
    )


def matched_share(
    matched: MatchedPoints, T_target_source: Float[Tensor, "k 4 4"], *, truncation: float
) -> Float[Tensor, " k"]:
    """How many source points a pose brings to a match of theirs, as a share of those that have one.

    One counts (1 − d²/truncation²) times the cosine of the normals, by the best of its matches.
    """
    source, source_normals, target, target_normals = (
        rows.T.contiguous()
        for rows in (
            matched.source,
            matched.source_normals,
            matched.target,
            matched.target_normals,
        )
    )
    points, row = matched.source_index.unique(return_inverse=True)
    shares = []
    for part in T_target_source.split(_POSES_AT_ONCE):
        difference = move_planes(part, source).sub_(target[:, None])
        near = squared_falloff(difference.square_().sum(0), truncation)
        turned = turn_planes(part[:, :3, :3], source_normals)
        near *= turned.mul_(target_normals[:, None]).sum(0).clamp_min_(0)
        best = near.new_zeros(len(part), len(points))
        best.scatter_reduce_(1, row.expand(len(part), -1), near, "amax")
        shares.append(best.mean(1))
    return torch.cat(shares)


def score_poses(
    points: Float[Tensor, "n 3"],
    area: Float[Tensor, " n"],
    grid: NearestGrid,
    T_grid_points: Float[Tensor, "k 4 4"],
    *,
    truncation: float,
) -> Float[Tensor, " k"]:
    """Mean over the points' area of max(0, 1 − d²/truncation²), d the distance to the grid's cloud.

    Counting area, not points, keeps dense parts of one cloud from being laid on dense parts of the
    other.
    """
    share = area / area.sum()
    parts = explained_parts(points, grid, T_grid_points, truncation=truncation)
    return torch.cat([part @ share for part in parts])


def explained_parts(
    points: Float[Tensor, "n 3"],
    grid: NearestGrid,
    T_grid_points: Float[Tensor, "k 4 4"],
    *,
    truncation: float,
) -> Iterator[Float[Tensor, "p n"]]:
    """How well the grid's cloud explains each point, max(0, 1 − d²/truncation²), a few poses each.

    Together the parts have a row for every pose.
    """
    planes = points.T.contiguous()
    for part in T_grid_points.split(_POSES_AT_ONCE):
        difference = grid.difference(move_planes(part, planes))
        yield squared_falloff(difference.square_().sum(0), truncation)


def pose_distances(
    T_target_source: Float[Tensor, "k 4 4"], source: Float[Tensor, "n 3"]
) -> Float[Tensor, "k k"]:
    """How far apart any two poses put the source: the RMS displacement of its points.

    With mean c and covariance S of the source points, mean |(T₁ − T₂)x|² is
    |(R₁ − R₂) S^½|² + |(R₁c + t₁) − (R₂c + t₂)|².
    """
    mean = source.mean(0)
    centered = source - mean
    values, vectors = torch.linalg.eigh(centered.T @ centered / len(source))
    root = vectors * values.clamp_min(0).sqrt()
    R, t = T_target_source[:, :3, :3], T_target_source[:, :3, 3]
    coordinates = torch.cat([(R @ root).flatten(1), R @ mean + t], 1)
    return torch.cdist(coordinates, coordinates)


def distinct(
    apart: Float[Tensor, "k k"],
    scores: Float[Tensor, " k"],
    *,
    radius: float,
    limit: int,
) -> Int[Tensor, " m"]:
    """Indices of the best-scored poses that lie at least `radius` apart, best first."""
    order = torch.argsort(scores, descending=True, stable=True)
    close = apart.numpy(force=True) < radius
    free = np.ones(len(close), dtype=bool)
    kept = []
    for row in order.tolist():
        if free[row]:
            kept.append(row)
            if len(kept) == limit:
                break
            free &= ~close[row]
    return torch.tensor(kept, device=order.device)


def _falloff(value: Float[Tensor, "*s"], tolerance: float) -> Float[Tensor, "*s"]:
    """1 at zero, 0 from `tolerance` on, quadratic between; works in place on `value`."""
    return squared_falloff(value.square_(), tolerance)
