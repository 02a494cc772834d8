"""Two clouds thinned to one common point spacing."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry.normals import estimate_normals
from fullturn.geometry.sampling import point_spacing, voxel_sample

# The voxel size is searched on at most this many points of each cloud.
_SEARCH_POINTS = 40_000


@dataclass(frozen=True, eq=False)
class Level:
    """A cloud at one resolution, in float32, its points in an order of their own."""

    points: Float[Tensor, "n 3"]
    normals: Float[Tensor, "n 3"]  # away from the cloud's mean


@dataclass(frozen=True, eq=False)
class LevelPair:
    """Both clouds at one resolution."""

    source: Level
    target: Level
    spacing: float  # point spacing of the coarser of the two


def thin_pair(
    source: Float[Tensor, "n 3"], target: Float[Tensor, "m 3"], *, limit: int
) -> tuple[Float[Tensor, "p 3"], Float[Tensor, "q 3"]]:
    """Both clouds as the means of voxels of one size, so that each has at most `limit` points.

    A cloud that is small enough already is kept as it is, unless its partner has to be thinned to
    a larger spacing. The rows come sorted, so that the order of the input does not matter.
    """
    size = _voxel_size(source, target, limit)
    if size is None:
        return _sorted(source), _sorted(target)
    return _sorted(voxel_sample(source, size)[0]), _sorted(voxel_sample(target, size)[0])


def level_pair(
    source: Float[Tensor, "p 3"],
    target: Float[Tensor, "q 3"],
    *,
    support: tuple[Float[Tensor, "n 3"], Float[Tensor, "m 3"]] | None = None,
    normal_neighbors: int = 20,
) -> LevelPair:
    """Normals and spacing for two thinned clouds; `support` are finer clouds for the normals."""
    finer = support or (source, target)
    levels = []
    for points, fine in zip((source, target), finer, strict=True):
        normals = estimate_normals(
            fine, k=min(normal_neighbors, len(fine)), queries=points, orientation="centroid"
        ).normals
        levels.append(Level(points.float(), normals.float()))
    spacing = max(point_spacing(source), point_spacing(target))
    return LevelPair(levels[0], levels[1], spacing)


def _voxel_size(source: Tensor, target: Tensor, limit: int) -> float | None:
    clouds = [source, target]
    if max(len(c) for c in clouds) <= limit:
        return None
    some = [c[:: max(1, len(c) // _SEARCH_POINTS)] for c in clouds]
    size = 2.0 / math.sqrt(limit)
    for _ in range(8):
        count = max(len(voxel_sample(c, size)[0]) for c in some)
        if 0.9 * limit <= count <= limit:
            break
        # Surfaces: the number of voxels falls with the square of their size.
        size *= math.sqrt(count / (0.95 * limit))
    return size


def _sorted(points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """Rows in lexicographic order."""
    for axis in (2, 1, 0):
        points = points[torch.argsort(points[:, axis], stable=True)]
    return points
