"""Matches, overlap and covariance of a pose, the same for every method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.geometry.cloud import Cloud
from fullturn.geometry.neighbors import NeighborIndex
from fullturn.geometry.sampling import point_spacing


@dataclass(frozen=True, eq=False)
class Explanation:
    """What a pose says about two clouds, in normalized lengths."""

    overlap: tuple[float, float]
    matches: np.ndarray
    match_weights: np.ndarray
    covariance: np.ndarray


def explain(source: Cloud, target: Cloud, T_target_source: Float[Tensor, "4 4"]) -> Explanation:
    """Nearest neighbors within 3 median spacings; point-to-point Gauss-Newton covariance."""
    moved = rigid.apply(T_target_source, source.points)
    index, distance = NeighborIndex(target.points).nearest(moved)
    radius = 3.0 * max(point_spacing(source.points), point_spacing(target.points))
    near = distance < radius
    kept = torch.nonzero(near)[:, 0]
    matches = torch.stack([kept, index[near]], -1).numpy(force=True)
    weights = (1.0 / (1.0 + (distance[near] / radius).square())).numpy(force=True)
    x = source.points[near]
    J = torch.zeros((len(x), 3, 6), dtype=x.dtype)
    J[:, :, 3:] = torch.eye(3, dtype=x.dtype)
    J[:, 0, 1], J[:, 0, 2], J[:, 1, 2] = x[:, 2], -x[:, 1], x[:, 0]
    J[:, 1, 0], J[:, 2, 0], J[:, 2, 1] = -x[:, 2], x[:, 1], -x[:, 0]
    information = (J.mT @ J).sum(0) + 1e-9 * torch.eye(6, dtype=x.dtype)
    noise_sq = float(distance[near].square().mean()) if len(x) else 1.0
    covariance = torch.linalg.inv(information) * max(noise_sq, 1e-18)
    return Explanation(
        pose_overlap(source, target, T_target_source), matches, weights, covariance.numpy()
    )


def pose_overlap(
    source: Cloud, target: Cloud, T_target_source: Float[Tensor, "4 4"]
) -> tuple[float, float]:
    """Shares of source and of target with a partner within 3 median spacings."""
    radius = 3.0 * max(point_spacing(source.points), point_spacing(target.points))
    moved = rigid.apply(T_target_source, source.points)
    there = NeighborIndex(target.points).nearest(moved)[1] < radius
    back = NeighborIndex(moved).nearest(target.points)[1] < radius
    return float(there.double().mean()), float(back.double().mean())
