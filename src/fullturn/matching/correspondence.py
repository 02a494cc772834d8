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


def candidate_matches(similarity: Float[Tensor, "n m"], *, limit: int | None = None) -> Matches:
    """Pairs of a point and its most similar point in the other cloud, both ways; the `limit` best.

    They are distinct: two points that are each other's most similar are one pair.
    """
    n, m = similarity.shape
    device = similarity.device
    key = torch.cat(
        [
            torch.arange(n, device=device) * m + similarity.argmax(1),
            similarity.argmax(0) * m + torch.arange(m, device=device),
        ]
    ).unique()
    value, order = torch.sort(similarity.reshape(-1)[key], descending=True, stable=True)
    key = key[order[:limit]]
    return Matches(key // m, key % m, value[:limit])
