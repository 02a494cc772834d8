"""Matches, overlap and covariance of a pose, the same for every method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.geometry.cloud import Cloud
from fullturn.pose.uncertainty import pose_covariance

# Farther apart than this (normalized) no noise carries a point.
_NOISE_REACH = 0.05


@dataclass(frozen=True, eq=False)
class Explanation:
    """What a pose says about two clouds, in normalized lengths."""

    overlap: tuple[float, float]  # (source share, target share) with a partner
    matches: np.ndarray  # (K, 2) int64
    match_weights: np.ndarray  # (K,) float64 in (0, 1]
    covariance: np.ndarray  # (6, 6), right perturbation


def explain(source: Cloud, target: Cloud, T_target_source: Float[Tensor, "4 4"]) -> Explanation:
    """Every source point's partner, the shares that have one, and how firmly the pose is held.

    Partners are nearest points within `partner_radius`; a match weighs (1 − d²/radius²)².
    """
    radius = partner_radius(source, target, T_target_source)
    moved = rigid.apply(T_target_source, source.points)
    partner, distance = target.index.nearest(moved, within=radius)
    near = distance < radius
    index = torch.nonzero(near)[:, 0]
    weights = (1 - (distance[near] / radius).square()).square()
    return Explanation(
        overlap=pose_overlap(source, target, T_target_source, radius=radius),
        matches=torch.stack([index, partner[near]], -1).numpy(force=True),
        match_weights=weights.numpy(force=True),
        covariance=pose_covariance(
            T_target_source.numpy(force=True), source, target, cutoff=radius
        ),
    )


def partner_radius(source: Cloud, target: Cloud, T_target_source: Float[Tensor, "4 4"]) -> float:
    """How far apart two points may lie and still show the same place.

    Twice the spacing of the sparser cloud, or three times the typical distance between the two
    surfaces where noise exceeds the spacing.
    """
    moved = rigid.apply(T_target_source, source.sample)
    _, distance = target.index.nearest(moved, within=_NOISE_REACH)
    spacing = 2.0 * max(source.spacing, target.spacing)
    close = distance[distance < _NOISE_REACH]
    return max(spacing, 3.0 * float(close.median()) if len(close) else 0.0)


def pose_overlap(
    source: Cloud,
    target: Cloud,
    T_target_source: Float[Tensor, "4 4"],
    *,
    radius: float | None = None,
) -> tuple[float, float]:
    """Shares of source and of target with a partner within `radius` (`partner_radius`)."""
    if radius is None:
        radius = partner_radius(source, target, T_target_source)
    moved = rigid.apply(T_target_source, source.sample)
    _, there = target.index.nearest(moved, within=radius)
    pulled = rigid.apply(rigid.invert(T_target_source), target.sample)
    _, back = source.index.nearest(pulled, within=radius)
    return float((there < radius).double().mean()), float((back < radius).double().mean())
