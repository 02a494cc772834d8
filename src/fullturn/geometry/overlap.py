"""How much of two posed clouds covers each other."""

from __future__ import annotations

from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.errors import InputError
from fullturn.geometry import rigid
from fullturn.geometry.neighbors import knn


def overlap(
    source: Float[Tensor, "n 3"],
    target: Float[Tensor, "m 3"],
    T_target_source: Float[Tensor, "4 4"],
    *,
    distance: float,
) -> tuple[float, float]:
    """Share of the source and of the target with a partner in the other within `distance`.

    >>> import torch
    >>> source = torch.tensor([[0.0, 0, 0], [1, 0, 0]])
    >>> overlap(source, source[:1], torch.eye(4), distance=0.1)
    (0.5, 1.0)
    """
    source_mask, target_mask = overlap_masks(source, target, T_target_source, distance=distance)
    return float(source_mask.double().mean()), float(target_mask.double().mean())


def overlap_masks(
    source: Float[Tensor, "n 3"],
    target: Float[Tensor, "m 3"],
    T_target_source: Float[Tensor, "4 4"],
    *,
    distance: float,
) -> tuple[Bool[Tensor, " n"], Bool[Tensor, " m"]]:
    """True for each point of source and target with a partner within `distance` (inclusive)."""
    if not distance >= 0:
        raise InputError(f"distance must not be negative, got {distance}")
    moved = rigid.apply(T_target_source.to(source), source)
    source_gap = knn(moved, target, 1)[1]
    target_gap = knn(target, moved, 1)[1]
    return source_gap[:, 0] <= distance, target_gap[:, 0] <= distance
