"""Nearest points of a cloud by one table lookup, for thousands of poses at once."""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

# A grid never has more cells than this (int32: 16 MB); a larger box gets larger cells.
_MAX_CELLS = 1 << 22
# Squared distance that stands for "nothing within the band".
_FAR = 1e6


class NearestGrid:
    """A narrow band of cells around a cloud; each holds the index of a nearby point.

    Near the cloud, the point found is the nearest one to the center of the cell that the query
    falls into, up to the size of a cell: enough to score and to refine poses, at a fraction of the
    cost of a k-d tree. Beyond the band there is no neighbor (index n, infinite for all purposes).
    Built by writing each point into the cells around it, farthest cells first.
    """

    def __init__(
        self,
        points: Float[Tensor, "n 3"],
        normals: Float[Tensor, "n 3"],
        *,
        cell: float,
        band: float,
        reach: float = 2.0,
    ) -> None:
        """`cell` and `band` are lengths; points farther than `reach` from the origin are left out.

        The cloud is expected to be centered, with a radius of about 1 (`Cloud`).
        """
        device = points.device
        inside = (points.abs() <= reach).all(-1)
        kept = points[inside]
        if len(kept) == 0:
            inside, kept = torch.ones_like(inside), points
        low, high = kept.amin(0), kept.amax(0)
        extent = (high - low) + 2 * (band + 2 * cell)
        volume = float(extent.double().prod())
        cell = max(cell, (volume / _MAX_CELLS) ** (1 / 3))
        self.cell = cell
        self._low = low - (band + 2 * cell)
        dims = ((high - self._low + band) / cell).ceil().long() + 2
        nx, ny, nz = dims.tolist()
        self._last = (dims - 1).to(points.dtype)
        steps = math.ceil(band / cell)
        line = torch.arange(-steps, steps + 1, device=device)
        offsets = torch.cartesian_prod(line, line, line)
        length_sq = offsets.square().sum(-1)
        near = length_sq <= (band / cell) ** 2
        offsets, length_sq = offsets[near], length_sq[near]
        offsets = offsets[torch.argsort(length_sq, descending=True, stable=True)]
        strides = torch.tensor([ny * nz, nz, 1], device=device)
        self._strides = strides.to(points.dtype)  # exact, as indices are below 2²⁴
        base = (((kept - self._low) / cell).floor().long() @ strides).numpy(force=True)
        index = torch.nonzero(inside)[:, 0].int().numpy(force=True)
        # In NumPy, which is three times as fast at many small assignments.
        table = np.full(nx * ny * nz, len(points), dtype=np.int32)
        for shift in (offsets @ strides).tolist():
            # Nearer cells come later and win; within one shift, cells of one grid may repeat
            # only where two points share a cell.
            table[base + shift] = index
        self._table = torch.from_numpy(table).to(device)
        blank = points.new_full((1, 3), math.sqrt(_FAR))
        points = torch.cat([points, blank])
        normals = torch.cat([normals, torch.zeros_like(blank)])
        self._planes = torch.cat([points, normals], 1).T.contiguous()

    def index(self, queries: Float[Tensor, " 3 *batch"]) -> Int[Tensor, "*batch"]:
        """Index of a nearby point for each query, n beyond the band."""
        one = (3,) + (1,) * (queries.dim() - 1)
        cells = (queries - self._low.view(one)).mul_(1 / self.cell)
        cells = torch.minimum(cells.clamp_min_(0), self._last.view(one)).floor_()
        flat = self._strides @ cells.view(3, -1)
        return self._table.index_select(0, flat.long()).long().view(queries.shape[1:])

    def difference(self, queries: Float[Tensor, " 3 *batch"]) -> Float[Tensor, " 3 *batch"]:
        """Query − point; far away beyond the band.

        Coordinates come first, here and in what is computed from it: whole planes of x, y and z are
        several times as fast as rows of three.
        """
        return queries - self._gathered(self._planes[:3], queries)

    def nearest(
        self, queries: Float[Tensor, " 3 *batch"]
    ) -> tuple[Float[Tensor, " 3 *batch"], Float[Tensor, " 3 *batch"]]:
        """`difference`, and the point's normal; zero beyond the band."""
        found = self._gathered(self._planes, queries)
        return queries - found[:3], found[3:]

    def _gathered(self, planes: Tensor, queries: Tensor) -> Tensor:
        found = planes.index_select(1, self.index(queries).view(-1))
        return found.view(len(planes), *queries.shape[1:])
