"""Two clouds thinned to one common point spacing."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from fullturn.geometry.cloud import Cloud
from fullturn.geometry.neighbors import NeighborIndex
from fullturn.geometry.normals import estimate_normals, oriented
from fullturn.geometry.sampling import local_area, point_spacing, voxel_sample

# The voxel size is searched on at least this many times as many points as are wanted.
_DENSE = 8
_FEW = 64
_LARGEST_VOXEL = 0.15  # of a cloud's own radius
_KEYPOINTS = 400
_NEIGHBORS = 20


@dataclass(frozen=True, eq=False)
class Level:
    """A cloud at one resolution, in float32, its points in an order of their own."""

    points: Float[Tensor, "n 3"]
    normals: Float[Tensor, "n 3"]  # away from the cloud's mean
    area: Float[Tensor, " n"]  # that each point stands for, 1 on average
    around: Int[Tensor, "n k"]  # the 20 nearest points, itself first, then by distance

    @property
    def keypoints(self) -> Int[Tensor, " k"]:
        """Rows of the points that are described and matched: at most 400, evenly over all rows."""
        count = min(len(self.points), _KEYPOINTS)
        return torch.arange(count, device=self.points.device) * len(self.points) // count


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
    if max(len(source), len(target)) <= limit:
        return _sorted(source), _sorted(target)
    size = max(_voxel_size(source, limit), _voxel_size(target, limit))
    return _thin(source, size), _thin(target, size)


def level_pair(
    source: Float[Tensor, "p 3"],
    target: Float[Tensor, "q 3"],
    *,
    support: tuple[Cloud, Cloud],
) -> LevelPair:
    """Normals and spacing for two thinned clouds; `support` are finer clouds for the normals."""
    return LevelPair(
        make_level(source, support[0]),
        make_level(target, support[1]),
        max(point_spacing(source), point_spacing(target)),
    )


def whole_pair(source: Cloud, target: Cloud) -> LevelPair:
    """Two clouds as they are: so few points that all of them are in the clouds' samples."""
    spacing = max(point_spacing(_sorted(cloud.distinct)) for cloud in (source, target))
    return LevelPair(_whole(source), _whole(target), spacing)


def make_level(points: Float[Tensor, "p 3"], support: Cloud) -> Level:
    """A thinned cloud with normals from the finer one."""
    wide, _ = support.index.knn(points, min(_NEIGHBORS, len(support.points)))
    normals = estimate_normals(
        support.points, queries=points, neighbor_index=wide, orientation="centroid"
    )
    around, distance = NeighborIndex(points).knn(points, min(_NEIGHBORS, len(points)))
    area = local_area(points, distance=distance)
    return Level(points.float(), normals.float(), area.float(), around)


def _whole(cloud: Cloud) -> Level:
    """All that the cloud knows of its points, in the order of a level."""
    order = _order(cloud.distinct)
    points, (around, distance) = cloud.distinct[order], cloud.around
    normals = oriented(cloud.sample_normals[order], points - points.mean(0))
    area = local_area(points, distance=distance[order])
    row = torch.empty_like(order).scatter_(0, order, torch.arange(len(order)).to(order))
    return Level(points.float(), normals.float(), area.float(), row[around[order]])


def _thin(points: Tensor, size: float) -> Tensor:
    thinned, _ = voxel_sample(points, size)
    if len(thinned) < _FEW:
        # A cloud far smaller than its partner must not vanish in one voxel.
        radius = float((points - points.mean(0)).norm(dim=-1).max())
        thinned, _ = voxel_sample(points, min(size, _LARGEST_VOXEL * radius))
    return _sorted(thinned)


def _voxel_size(points: Tensor, limit: int) -> float:
    """The voxel size that leaves between 0.85 × `limit` and `limit` points; 0 if all may stay."""
    if len(points) <= limit:
        return 0.0
    size = 2.0 / math.sqrt(limit)
    # Counted on means of much smaller voxels: as good, and cheap for millions of points.
    some = points
    for finer in (4, 16, 64):
        if len(points) > _DENSE * limit:
            some = voxel_sample(points, size / finer)[0]
        if len(some) >= _DENSE * limit:
            break
    for _ in range(12):
        count = len(voxel_sample(some, size)[0])
        if 0.85 * limit <= count <= limit:
            break
        # Surfaces: the number of voxels falls with the square of their size.
        size *= math.sqrt(count / (0.93 * limit))
    while len(voxel_sample(points, size)[0]) > limit:
        size *= 1.05
    return size


def _sorted(points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    return points[_order(points)]


def _order(points: Float[Tensor, "n 3"]) -> Int[Tensor, " n"]:
    """Rows in lexicographic order."""
    order = torch.argsort(points[:, 2], stable=True)
    for axis in (1, 0):
        order = order[torch.argsort(points[order, axis], stable=True)]
    return order
