"""Ranked candidate matches between the points of two clouds."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True, eq=False)
class Matches:
    """Candidate pairs of points, the most similar first."""

    source: Int[Tensor, " m"]
    target: Int[Tensor, " m"]
    similarity: Float[Tensor, " m"]


def candidate_matches(
    similarity: Float[Tensor, "n m"],
    *,
    per_point: int = 2,
    limit: int = 1000,
    mutual_bonus: float = 0.02,
) -> Matches:
    """The `limit` best pairs out of each point's most similar points in the other cloud.

    Each source point offers its `per_point` best targets, each target point its best source.
    Pairs offered from both sides get a bonus on their similarity.
    """
    n, m = similarity.shape
    per_point = min(per_point, m)
    forward = similarity.topk(per_point, dim=1)
    backward = similarity.max(dim=0)
    device = similarity.device
    key = torch.cat(
        [
            (torch.arange(n, device=device)[:, None] * m + forward.indices).reshape(-1),
            backward.indices * m + torch.arange(m, device=device),
        ]
    )
    key, count = torch.unique(key, return_counts=True)
    value = similarity.reshape(-1)[key] + mutual_bonus * (count > 1)
    value, order = torch.sort(value, descending=True, stable=True)
    key = key[order[:limit]]
    return Matches(key // m, key % m, value[:limit])
