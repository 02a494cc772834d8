"""The points of all clouds of a batch in one list of rows, without padding.

Maps of single points then need no mask, statistics over points are exact, and a cloud's result
does not depend on its company. Indices into the list are called rows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from fullturn.geometry.neighbors import MISSING, knn
from fullturn.geometry.sampling import farthest_point_sample


@dataclass(frozen=True, eq=False)
class Rows:
    """Points of several clouds, one cloud after the other."""

    points: Float[Tensor, "t 3"]
    sizes: tuple[int, ...]  # points of each cloud

    @property
    def starts(self) -> tuple[int, ...]:
        """The row at which each cloud begins."""
        return tuple(sum(self.sizes[:i]) for i in range(len(self.sizes)))

    def each(self) -> tuple[Float[Tensor, "n 3"], ...]:
        """The clouds one by one."""
        return self.points.split(self.sizes)

    def centered(self) -> Rows:
        """The same clouds, each with its mean at the origin."""
        return Rows(torch.cat([cloud - cloud.mean(0) for cloud in self.each()]), self.sizes)


def pack(values: Float[Tensor, "b n c"], mask: Bool[Tensor, "b n"]) -> Float[Tensor, "t c"]:
    """The rows of a padded batch where the mask is True.

    >>> pack(torch.tensor([[[1.0], [2]], [[3], [3]]]), torch.tensor([[True, True], [True, False]]))
    tensor([[1.],
            [2.],
            [3.]])
    """
    return values.flatten(0, 1) if bool(mask.all()) else values[mask]


def unpack(rows: Float[Tensor, "t c"], mask: Bool[Tensor, "b n"]) -> Float[Tensor, "b n c"]:
    """The inverse of `pack`, with zeros where the mask is False."""
    b, n = mask.shape
    if len(rows) == b * n:
        return rows.view(b, n, -1)
    place = mask.flatten().nonzero()[:, 0]
    padded = rows.new_zeros(b * n, rows.shape[-1]).index_copy(0, place, rows)
    return padded.view(b, n, -1)


def nearest_rows(
    queries: Rows, points: Rows, k: int
) -> tuple[Int[Tensor, "q k"], Float[Tensor, "q k"]]:
    """Row and distance of the k nearest points of the same cloud; −1 and inf where fewer exist."""
    if len({*queries.sizes}) == 1 and len({*points.sizes}) == 1:
        b = len(points.sizes)
        index, distance = knn(queries.points.view(b, -1, 3), points.points.view(b, -1, 3), k)
        start = torch.tensor(points.starts, device=index.device).view(-1, 1, 1)
        return _shifted(index, start).flatten(0, 1), distance.flatten(0, 1)
    found = [knn(*pair, k) for pair in zip(queries.each(), points.each(), strict=True)]
    rows = [_shifted(local, start) for (local, _), start in zip(found, points.starts, strict=True)]
    return torch.cat(rows), torch.cat([distance for _, distance in found])


def farthest_rows(points: Rows, counts: Sequence[int]) -> Int[Tensor, " m"]:
    """Farthest point samples of `counts` points of each cloud, each begun with its first point."""
    if points.points.device.type == "cpu":
        samples = [
            farthest_point_sample(cloud, count)
            for cloud, count in zip(points.each(), counts, strict=True)
        ]
    else:
        samples = _farthest_together(points, counts)
    starts = zip(samples, points.starts, strict=True)
    return torch.cat([sample + start for sample, start in starts])


def _farthest_together(points: Rows, counts: Sequence[int]) -> list[Int[Tensor, " _"]]:
    """All clouds at once: each step is a handful of launches, whatever the number of clouds."""
    clouds = torch.nn.utils.rnn.pad_sequence(list(points.each()), batch_first=True)
    b, longest, _ = clouds.shape
    sizes = torch.tensor(points.sizes, device=clouds.device)[:, None]
    padding = torch.arange(longest, device=clouds.device) >= sizes
    best_sq = torch.where(padding, -2.0, math.inf).to(clouds.dtype)
    index = torch.zeros(b, 1, dtype=torch.int64, device=clouds.device)
    chosen = torch.empty(b, max(counts), dtype=torch.int64, device=clouds.device)
    for step in range(max(counts)):
        chosen[:, step : step + 1] = index
        last = clouds.gather(1, index[..., None].expand(b, 1, 3))
        best_sq = torch.minimum(best_sq, (clouds - last).square_().sum(-1))
        best_sq.scatter_(1, index, -1.0)  # no point twice, before padding
        index = best_sq.argmax(1, keepdim=True)
    return [row[:count] for row, count in zip(chosen, counts, strict=True)]


def _shifted(index: Tensor, start: Tensor | int) -> Tensor:
    return torch.where(index < 0, MISSING, index + start)
