"""Nearest neighbors: k-d trees for tensors on the CPU, brute force in chunks elsewhere.

Indices and distances are detached from autograd. Where two neighbors are equally far, the order
is the same in every run with the same input, but otherwise unspecified.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
import small_gicp
import torch
from jaxtyping import Float, Int
from torch import Tensor

from fullturn.errors import InputError

MISSING = -1
# Distances held at once by the brute-force search: 256 MB in float32.
_MAX_DISTANCES_AT_ONCE = 1 << 26
# The grid that sorts out far queries: cells along its longest side, and how far it may be grown.
_MAX_SIDE = 96
_MAX_GROWTH = 8


def knn(
    queries: Float[Tensor, "*batch m 3"], points: Float[Tensor, "*batch n 3"], k: int
) -> tuple[Int[Tensor, "*batch m k"], Float[Tensor, "*batch m k"]]:
    """Index and distance of the k nearest points of each query, nearest first.

    Where fewer than k points exist the rest is −1 and inf. Distances are Euclidean, in the dtype
    of the queries.

    >>> cloud = torch.tensor([[0.0, 0, 0], [3, 0, 0], [1, 0, 0]])
    >>> knn(cloud[:1], cloud, 2)
    (tensor([[0, 2]]), tensor([[0., 1.]]))
    """
    _check(queries, points, k)
    if points.device.type != "cpu":
        return _knn_torch(queries, points, k)
    if points.ndim == 2:
        return NeighborIndex(points).knn(queries, k)
    batch = points.shape[:-2]
    index = torch.empty((*batch, queries.shape[-2], k), dtype=torch.int64)
    distance = torch.empty((*batch, queries.shape[-2], k), dtype=queries.dtype)
    for item in np.ndindex(*batch):
        index[item], distance[item] = NeighborIndex(points[item]).knn(queries[item], k)
    return index, distance


def radius_neighbors(
    queries: Float[Tensor, "*batch m 3"],
    points: Float[Tensor, "*batch n 3"],
    radius: float,
    *,
    max_neighbors: int,
) -> tuple[Int[Tensor, "*batch m k"], Float[Tensor, "*batch m k"]]:
    """The nearest points within a radius (inclusive), at most `max_neighbors` of them.

    Always `max_neighbors` columns, nearest first, padded with −1 and inf.
    """
    _check_radius(radius)
    return _within(*knn(queries, points, max_neighbors), radius)


class NeighborIndex:
    """Answers many neighbor queries about one cloud; the tree is built once.

    >>> NeighborIndex(torch.tensor([[0.0, 0, 0], [3, 0, 0]])).nearest(torch.tensor([[2.0, 0, 0]]))
    (tensor([1]), tensor([1.]))
    """

    def __init__(self, points: Float[Tensor, "n 3"]) -> None:
        _check(points, points, 1)
        self.points = points.detach()
        self._tree: small_gicp.KdTree | None = None
        if points.device.type == "cpu":
            # Centered, so that a cloud far from the origin loses nothing to rounding.
            raw = self.points.double().numpy()
            self._center = raw.mean(axis=0)
            if not np.isfinite(self._center).all():
                raise InputError("points must be finite, got NaN or infinity; drop those rows")
            self._tree = small_gicp.KdTree(raw - self._center)

    def knn(
        self, queries: Float[Tensor, "m 3"], k: int, *, within: float = math.inf
    ) -> tuple[Int[Tensor, "m k"], Float[Tensor, "m k"]]:
        """Index and distance of the k nearest points; −1 and inf where fewer are `within` reach.

        A finite reach is much faster where many queries lie far away: a k-d tree is slow at those,
        so they are sorted out beforehand on a grid of occupied cells.
        """
        _check(queries, self.points, k)
        queries = queries.detach()
        if not math.isfinite(within):
            return self._search(queries, k)
        near = self._occupancy.near(queries, within)
        if bool(near.all()):
            return _within(*self._search(queries, k), within)
        index = near.new_full((len(queries), k), MISSING, dtype=torch.int64)
        distance = queries.new_full((len(queries), k), math.inf)
        index[near], distance[near] = _within(*self._search(queries[near], k), within)
        return index, distance

    def nearest(
        self, queries: Float[Tensor, "m 3"], *, within: float = math.inf
    ) -> tuple[Int[Tensor, " m"], Float[Tensor, " m"]]:
        """Index and distance of the single nearest point; −1 and inf where none is `within` reach.

        As of `knn`, a finite reach is faster.
        """
        index, distance = self.knn(queries, 1, within=within)
        return index[:, 0], distance[:, 0]

    def _search(self, queries: Tensor, k: int) -> tuple[Tensor, Tensor]:
        if self._tree is None:
            return _knn_torch(queries, self.points, k)
        if len(queries) == 0:
            return torch.empty((0, k), dtype=torch.int64), torch.empty((0, k), dtype=queries.dtype)
        centered = queries.double().numpy() - self._center
        unsigned, distance_sq = self._tree.batch_knn_search(centered, k, 1)
        index = unsigned.view(np.int64)  # the tree marks a missing neighbor by 2⁶⁴ − 1
        distance = np.sqrt(distance_sq, out=distance_sq)
        if k > len(self.points):
            distance[:, len(self.points) :] = np.inf
        return torch.from_numpy(index), torch.from_numpy(distance).to(queries.dtype)

    @cached_property
    def _occupancy(self) -> _Occupancy:
        return _Occupancy(self.points)


class NearestTracker:
    """`NeighborIndex.nearest` for the same queries again and again, while they move a little.

    The answers are the same. A query is searched for anew only once it has moved so far that
    another point may have become the nearest, or have come within reach. Queries are NumPy arrays:
    of some hundred points, a call of PyTorch costs more than what it computes.
    """

    def __init__(self, index: NeighborIndex) -> None:
        self._index = index
        self._within = -math.inf  # the reach that all of this holds for
        self._at = np.empty((0, 3))  # where queries were when they were searched for
        self._found = np.empty(0, dtype=np.int64)
        self._free_sq = np.empty(0)  # how far they may go from there, squared

    def nearest(self, queries: Float[np.ndarray, "m 3"], *, within: float) -> Int[np.ndarray, " m"]:
        """Index of the nearest point, and of any point or −1 where none is `within` reach.

        Row k is the same query in every call. The array is this object's own.
        """
        if within > self._within:
            self._within, self._at = within, queries.copy()
            self._found, self._free_sq = self._searched(queries, 2 * within)
            return self._found
        moved = queries - self._at
        stale = np.flatnonzero(np.einsum("ij,ij->i", moved, moved) > self._free_sq)
        if len(stale):
            self._at[stale] = queries[stale]
            # So few that sorting out the far ones would take longer.
            self._found[stale], self._free_sq[stale] = self._searched(queries[stale], math.inf)
        return self._found

    def _searched(
        self, queries: Float[np.ndarray, "m 3"], within: float
    ) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """The nearest point, and how far that holds, squared.

        Half of what the second one is farther away; if the first one is beyond the reach, at least
        as far as it takes to come within.
        """
        here = torch.from_numpy(queries).to(self._index.points)
        index, distance = self._index.knn(here, 2, within=within)
        first, second = np.minimum(distance.numpy(force=True), within).T
        # Two missing points are infinitely far, and so is what lies between them.
        gap = np.subtract(second, first, out=np.zeros_like(first), where=np.isfinite(first))
        free = np.maximum(gap / 2, first - self._within)
        return index[:, 0].numpy(force=True), free * free


class _Occupancy:
    """Which cells of a coarse grid hold points: tells quickly what is far from all of them."""

    def __init__(self, points: Tensor) -> None:
        side = min(_MAX_SIDE, max(8, round(2 * len(points) ** (1 / 3))))
        self._low = points.amin(0)
        extent = points.amax(0) - self._low
        self._cell = max(float(extent.max()) / side, torch.finfo(points.dtype).tiny)
        self._size = ((extent / self._cell).floor().long() + 1).tolist()
        table = torch.zeros(self._size, dtype=torch.bool, device=points.device)
        table[((points - self._low) / self._cell).floor().long().unbind(-1)] = True
        self._table = table
        self._grown: dict[int, tuple[Tensor, Tensor, Tensor]] = {}

    def near(self, queries: Tensor, reach: float) -> Tensor:
        """False only where no point lies within the reach."""
        steps = reach / self._cell
        if steps > _MAX_GROWTH:
            return torch.ones(queries.shape[:-1], dtype=torch.bool, device=queries.device)
        grow = max(1, math.ceil(steps))
        if grow not in self._grown:
            self._grown[grow] = self._grow(grow)
        table, last, strides = self._grown[grow]
        cell = ((queries - self._low) / self._cell).floor_().add_(grow + 1).nan_to_num_()
        flat = torch.minimum(cell.clamp_min_(0), last.to(cell)) @ strides.to(cell)
        return table[flat.long()]

    def _grow(self, cells: int) -> tuple[Tensor, Tensor, Tensor]:
        """The flat table of what is so many cells from a point, its last cell, and its strides.

        A rim of empty cells stands for all that lies outside.
        """
        grown = torch.nn.functional.pad(self._table, [cells + 1] * 6)
        for axis, size in enumerate(grown.shape):
            line = grown.clone()
            for step in range(1, cells + 1):
                rest = size - step
                line.narrow(axis, step, rest).logical_or_(grown.narrow(axis, 0, rest))
                line.narrow(axis, 0, rest).logical_or_(grown.narrow(axis, step, rest))
            grown = line
        last = self._low.new_tensor(grown.shape) - 1
        return grown.flatten(), last, self._low.new_tensor(grown.stride())


def gather(
    values: Float[Tensor, "*batch n c"], index: Int[Tensor, "*batch m k"]
) -> Float[Tensor, "*batch m k c"]:
    """Rows of `values` at the neighbors; a missing neighbor (−1) gives the first row: mask it."""
    n, channels = values.shape[-2:]
    flat = index.clamp_min(0)
    batch = values.shape[:-2]
    if batch:
        offset = torch.arange(math.prod(batch), device=index.device).mul(n).view(*batch, 1, 1)
        flat = flat + offset
    rows = values.reshape(-1, channels).index_select(0, flat.reshape(-1))
    return rows.view(*index.shape, channels)


def fill_with_self(neighbor_index: Int[Tensor, "*batch n k"]) -> Int[Tensor, "*batch n k"]:
    """Replace each missing neighbor (−1) by the point itself."""
    own = torch.arange(neighbor_index.shape[-2], device=neighbor_index.device)[:, None]
    return torch.where(neighbor_index < 0, own, neighbor_index)


def _knn_torch(queries: Tensor, points: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """Brute force on any device, in chunks of queries."""
    # Centered, and without the |a|² + |b|² − 2ab expansion: both would cost digits in float32.
    center = points.detach().mean(dim=-2, keepdim=True)
    queries, points = queries.detach() - center, points.detach() - center
    n = points.shape[-2]
    found = min(k, n)
    rows = max(1, _MAX_DISTANCES_AT_ONCE // max(1, math.prod(points.shape[:-1])))
    shape = (*queries.shape[:-1], k)
    index = torch.full(shape, MISSING, dtype=torch.int64, device=points.device)
    distance = torch.full(shape, math.inf, dtype=queries.dtype, device=points.device)
    for first in range(0, queries.shape[-2], rows):
        part = slice(first, first + rows)
        pairwise = torch.cdist(
            queries[..., part, :], points, compute_mode="donot_use_mm_for_euclid_dist"
        )
        nearest = pairwise.topk(found, dim=-1, largest=False, sorted=True)
        index[..., part, :found] = nearest.indices
        distance[..., part, :found] = nearest.values
    return index, distance


def _within(index: Tensor, distance: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    outside = distance > radius
    return index.masked_fill_(outside, MISSING), distance.masked_fill_(outside, math.inf)


def _check(queries: Tensor, points: Tensor, k: int) -> None:
    if points.shape[-1] != 3 or queries.shape[-1] != 3:
        raise InputError(
            f"queries and points must have 3 columns, got shapes {tuple(queries.shape)} "
            f"and {tuple(points.shape)}"
        )
    if points.shape[-2] == 0:
        raise InputError("points must hold at least one point, got none")
    if k < 1:
        raise InputError(f"at least one neighbor must be asked for, got {k}")


def _check_radius(radius: float) -> None:
    if not radius > 0:
        raise InputError(f"radius must be positive, got {radius}")
