"""Robust ICP from aligned means: the local baselines, point to point and point to plane."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from typing import ClassVar, final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.geometry.cloud import Cloud
from fullturn.geometry.neighbors import NeighborIndex
from fullturn.geometry.normals import estimate_normals
from fullturn.geometry.sampling import point_spacing, voxel_sample
from fullturn.methods.base import Estimate, Method, Traits
from fullturn.pose.kabsch import nearest_motion, weighted_kabsch
from fullturn.pose.residuals import gauss_newton_step, plane_equations


@dataclass(frozen=True)
class IcpConfig:
    """How far ICP looks, and when it stops; lengths are normalized (1 is the cloud's radius)."""

    max_points: int = 5000  # per cloud; larger clouds are thinned on a grid
    start_scale: float = 0.5  # of the residuals at first: coarse alignment
    shrink: float = 0.7  # of the scale, per level, down to the measured noise
    iterations_per_level: int = 10
    iterations_at_end: int = 50
    tolerance: float = 1e-9  # of a step, at which the last level ends
    neighbors: int = 20  # of a normal


@dataclass(frozen=True, eq=False)
class _Side:
    """One thinned cloud, ready for search."""

    points: Float[Tensor, "n 3"]
    index: NeighborIndex
    normals: Float[Tensor, "n 3"] | None = field(default=None)


class _Icp(Method):
    """Both clouds look for their nearest partners in the other, so swapping them inverts T.

    1. Start: the means on one another, no rotation. Clouds arrive centered on their means, so
       this is all that is known of "the poses as given".
    2. Partners: the nearest target point of each moved source point, and the reverse.
    3. Weights: Geman-McClure of the residual, w = (s²/(s² + r²))², zero beyond the gate.
    4. Step: weighted Kabsch, or Gauss-Newton on the distances to the partners' planes.
    5. The scale s shrinks from coarse to 1.48 times the median residual.

    It states no probability: it sees no rivals, so poses that fit as well, as those of a symmetric
    shape do, would take nothing off it.
    """

    traits = Traits(local=True)
    to_plane: ClassVar[bool]
    config: ClassVar[IcpConfig] = IcpConfig()

    def estimate(self, source: Cloud, target: Cloud, *, rng: np.random.Generator) -> Estimate:
        begin = time.perf_counter()
        source_side, target_side = (self._side(cloud.points) for cloud in (source, target))
        prepared = time.perf_counter()
        T_target_source = _align(source_side, target_side, self.config)
        end = time.perf_counter()
        return Estimate(
            T_target_source=T_target_source.unsqueeze(0),
            seconds={"prepare": prepared - begin, "align": end - prepared},
        )

    def _side(self, points: Tensor) -> _Side:
        size = point_spacing(points)
        thin = points
        while len(thin) > self.config.max_points:
            thin = points[voxel_sample(points, size)[1]]
            size *= 1.25
        normals = None
        if self.to_plane:
            k = min(self.config.neighbors, len(thin))
            normals = estimate_normals(thin, k=k, orientation="none")
        return _Side(thin, NeighborIndex(thin), normals)


@final
class IcpPoint(_Icp):
    """Robust point-to-point ICP."""

    name = "icp-point"
    summary = "robust point-to-point ICP; needs a rough alignment"
    reference = "Besl & McKay 1992, with Geman-McClure weights of shrinking scale"
    to_plane = False


@final
class IcpPlane(_Icp):
    """Robust point-to-plane ICP."""

    name = "icp-plane"
    summary = "robust point-to-plane ICP; needs a rough alignment"
    reference = "Chen & Medioni 1992, with Geman-McClure weights of shrinking scale"
    to_plane = True


def _align(source: _Side, target: _Side, config: IcpConfig) -> Tensor:
    T = torch.eye(4, dtype=source.points.dtype, device=source.points.device)
    spacing = max(point_spacing(source.points), point_spacing(target.points))
    scale, last = config.start_scale, False
    while True:
        gate = max(3.0 * scale, 2.0 * spacing)
        for _ in range(config.iterations_at_end if last else config.iterations_per_level):
            moved, partner, normal = _partners(source, target, T)
            residual, near = _residuals(moved, partner, normal, gate)
            if not bool(near.any()):
                return T
            weight = torch.where(near, (scale**2 / (scale**2 + residual.square())).square(), 0.0)
            step = _step(moved, partner, normal, weight)
            T = step @ T
            moving = float((step - torch.eye(4).to(step)).abs().max())
            if moving < (config.tolerance if last else 0.01 * scale):
                break
        if last:
            return nearest_motion(T)
        residual, near = _residuals(*_partners(source, target, T), gate)
        if not bool(near.any()):
            return nearest_motion(T)
        noise = max(1.4826 * float(residual[near].median()), 1e-6 * spacing)
        last = config.shrink * scale <= noise
        scale = max(config.shrink * scale, noise)


def _partners(source: _Side, target: _Side, T: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
    """Moved source points, their partners and the partners' normals, found from both sides."""
    moved = rigid.apply(T, source.points)
    to_target, _ = target.index.nearest(moved)
    to_source, _ = source.index.nearest(rigid.apply(rigid.invert(T), target.points))
    normal = None
    if source.normals is not None and target.normals is not None:
        turned = source.normals @ T[:3, :3].mT
        normal = torch.cat([target.normals[to_target], turned[to_source]])
    return (
        torch.cat([moved, moved[to_source]]),
        torch.cat([target.points[to_target], target.points]),
        normal,
    )


def _residuals(
    moved: Tensor, partner: Tensor, normal: Tensor | None, gate: float
) -> tuple[Tensor, Tensor]:
    apart = moved - partner
    distance = torch.linalg.vector_norm(apart, dim=-1)
    residual = distance if normal is None else (apart * normal).sum(-1).abs()
    return residual, distance < gate


def _step(moved: Tensor, partner: Tensor, normal: Tensor | None, weight: Tensor) -> Tensor:
    if normal is None:
        return weighted_kabsch(moved, partner, weight)
    H, g = plane_equations(moved.T, (moved - partner).T, normal.T, weight)
    # Directions in which planes slide on one another stay where they are.
    step = gauss_newton_step(
        H.numpy(force=True), g.numpy(force=True), damping=1e-9, largest=math.inf
    )
    return rigid.exp_se3(torch.from_numpy(step).to(g))
