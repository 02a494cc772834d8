"""Thinning: farthest points, voxel means, and the spacing of a cloud."""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from fullturn.errors import InputError
from fullturn.geometry.neighbors import NeighborIndex

# The median of this many nearest-neighbor distances is stable to a few percent.
_SPACING_QUERIES = 2000
_AREA_NEIGHBORS = 16


def farthest_point_sample(
    points: Float[Tensor, "n 3"], count: int, *, start: int = 0
) -> Int[Tensor, " count"]:
    """Indices of `count` points, each the farthest from all before it, beginning with `start`.

    Exact, and no index comes twice: duplicates are taken only when nothing else is left. Ties go
    to the lowest index.

    >>> line = torch.tensor([[0.0, 0, 0], [1, 0, 0], [5, 0, 0], [9, 0, 0]])
    >>> farthest_point_sample(line, 3)
    tensor([0, 3, 2])
    """
    n = len(points)
    if not 0 <= count <= n:
        raise InputError(f"count must lie between 0 and the number of points, {n}, got {count}")
    if count and not 0 <= start < n:
        raise InputError(f"start must be an index into {n} points, got {start}")
    if points.device.type == "cpu":
        return torch.from_numpy(_farthest_numpy(points.detach().double().numpy(), count, start))
    return _farthest_torch(points.detach(), count, start)


def voxel_sample(
    points: Float[Tensor, "n 3"], voxel_size: float
) -> tuple[Float[Tensor, "m 3"], Int[Tensor, " m"]]:
    """Mean of the points in each occupied voxel, and the index of the point nearest to that mean.

    The grid starts at the lowest corner of the cloud, so it moves along with a shifted cloud.
    Voxels come in the order of their cells (x slowest): reordering the points changes the means by
    rounding only, and the representatives, as points, not at all.

    >>> means, index = voxel_sample(torch.tensor([[0.0, 0, 0], [5, 0, 0], [0.2, 0, 0]]), 1.0)
    >>> means[:, 0], index
    (tensor([0.1000, 5.0000]), tensor([0, 1]))
    """
    if not voxel_size > 0:
        raise InputError(f"voxel_size must be positive, got {voxel_size}")
    points = points.detach()
    n = len(points)
    if n == 0:
        return points.clone(), torch.empty(0, dtype=torch.int64, device=points.device)
    cells = (points - points.amin(0)).div_(voxel_size).floor_()
    key, order = torch.sort(_cell_keys(cells), stable=True)
    _, counts = torch.unique_consecutive(key, return_counts=True)
    voxels = len(counts)
    voxel = torch.repeat_interleave(
        torch.arange(voxels, device=points.device), counts, output_size=n
    )
    ordered = points.index_select(0, order)
    means = torch.segment_reduce(ordered, "mean", lengths=counts, unsafe=True)

    offset = ordered.sub_(means.index_select(0, voxel)).div_(voxel_size)
    distance_sq = offset.square().sum(-1)
    tolerance = 64 * torch.finfo(points.dtype).eps
    near = distance_sq <= _segment_min(distance_sq, counts)[voxel] + tolerance
    # Two points are always equally far from their mean; a direction without symmetry decides,
    # so that the choice does not hang on their order.
    direction = torch.tensor([1.0, 0.7548776662, 0.5698402910]).to(offset)
    score = torch.where(near, offset @ direction, math.inf)
    tied = score <= _segment_min(score, counts)[voxel] + tolerance
    position = torch.where(tied, torch.arange(n, device=points.device), n)
    first = torch.full((voxels,), n, device=points.device)
    return means, order[first.scatter_reduce_(0, voxel, position, "amin")]


def point_spacing(points: Float[Tensor, "n 3"], *, index: NeighborIndex | None = None) -> float:
    """Median distance from a point to the nearest other point that does not coincide with it.

    At most 2,000 points, evenly spread over the rows, are asked. `index` is a tree of the same
    points, where there is one already.

    >>> point_spacing(torch.tensor([[0.0, 0, 0], [0, 0, 0], [2, 0, 0], [4, 0, 0]]))
    2.0
    """
    n = len(points)
    step = max(1, -(-n // _SPACING_QUERIES))
    queries = points[::step]
    distance = (index or NeighborIndex(points)).knn(queries, 2)[1][:, 1]
    if n > 1 and bool((distance == 0).any()):
        distinct = torch.unique(points.detach(), dim=0)
        n = len(distinct)
        distance = NeighborIndex(distinct).knn(queries, 2)[1][:, 1]
    if n < 2:
        raise InputError(f"point_spacing needs at least two distinct points, got {n}")
    return float(distance.median())


def evenly(rows: int, about: int) -> slice:
    """About so many of the rows, evenly over all of them; all where they are fewer.

    >>> list(range(10))[evenly(10, 5)]
    [0, 2, 4, 6, 8]
    """
    return slice(None, None, max(1, round(rows / about)))


def local_area(
    points: Float[Tensor, "n 3"], *, distance: Float[Tensor, "n k"] | None = None
) -> Float[Tensor, " n"]:
    """Surface area that each point stands for, up to a common factor: 1 on average.

    The squared distance to the 16th nearest point, held within a tenth and ten times the median.
    `distance` is that to the nearest points, itself first, where somebody has them; 16 at least.
    """
    if len(points) < 2:
        return torch.ones_like(points[:, 0])
    if distance is None:
        distance = NeighborIndex(points).knn(points, min(_AREA_NEIGHBORS, len(points)))[1]
    area = distance[:, min(_AREA_NEIGHBORS, len(points)) - 1].square()
    median = area.median().clamp_min(torch.finfo(area.dtype).tiny)
    area = (area / median).clamp_(0.1, 10.0)
    return area / area.mean()


def _farthest_numpy(points: np.ndarray, count: int, start: int) -> np.ndarray:
    # One axis at a time in preallocated buffers: at these sizes NumPy's cost is the allocation and
    # the broadcasting, not the arithmetic. Differences, not the |a|² + |b|² − 2ab expansion, so
    # that a far outlier does not blur the rest.
    chosen = np.empty(count, dtype=np.int64)
    if count == 0:
        return chosen
    axes = np.ascontiguousarray(points.T)
    x, y, z = axes
    xs, ys, zs = axes.tolist()
    buffer = np.empty_like(axes)
    dx, dy, dz = buffer
    best_sq = np.full(len(points), np.inf)
    index = start
    for step in range(count):
        chosen[step] = index
        np.subtract(x, xs[index], out=dx)
        np.subtract(y, ys[index], out=dy)
        np.subtract(z, zs[index], out=dz)
        np.multiply(buffer, buffer, out=buffer)
        np.add(dx, dy, out=dx)
        np.add(dx, dz, out=dx)
        np.minimum(best_sq, dx, out=best_sq)
        best_sq[index] = -1.0
        index = int(best_sq.argmax())
    return chosen


def _farthest_torch(points: Tensor, count: int, start: int) -> Tensor:
    # Indices stay on the device: no synchronization in the loop.
    chosen = torch.empty(count, dtype=torch.int64, device=points.device)
    best_sq = torch.full((len(points),), math.inf, dtype=points.dtype, device=points.device)
    index = torch.full((1,), start, dtype=torch.int64, device=points.device)
    for step in range(count):
        chosen[step] = index[0]
        distance_sq = (points - points.index_select(0, index)).square_().sum(-1)
        best_sq = torch.minimum(best_sq, distance_sq).index_fill_(0, index, -1.0)
        index = best_sq.argmax(keepdim=True)
    return chosen


def _cell_keys(cells: Tensor) -> Tensor:
    """One integer per cell, increasing with x, then y, then z."""
    if float((cells.amax(0) + 1).double().prod()) >= 2.0**62:
        # Too many cells for one integer: number the occupied layers of each axis instead.
        layers = [torch.unique(axis, return_inverse=True)[1] for axis in cells.unbind(-1)]
        cells = torch.stack(layers, dim=-1)
    cells = cells.long()
    _, ny, nz = (cells.amax(0) + 1).tolist()
    return (cells[:, 0] * ny + cells[:, 1]) * nz + cells[:, 2]


def _segment_min(values: Tensor, counts: Tensor) -> Tensor:
    return torch.segment_reduce(values, "min", lengths=counts, unsafe=True)
