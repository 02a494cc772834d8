"""What tells a right pose from a wrong one, measured on both clouds."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.geometry.neighbors import NeighborIndex, gather
from fullturn.pose.levels import Level


@dataclass(frozen=True, eq=False)
class Surface:
    """A cloud prepared for verification."""

    points: Float[Tensor, "n 3"]
    smooth: Float[Tensor, "n 3"]  # moved along the normal into the mean plane of the neighbors
    normals: Float[Tensor, "n 3"]
    variation: Float[Tensor, " n"]
    interior: Bool[Tensor, " n"]  # False on the rim of a partial cloud
    index: NeighborIndex
    descriptors: Float[Tensor, "n c"]


def prepare_surface(level: Level, descriptors: Tensor, *, neighbors: int = 12) -> Surface:
    """The cloud with its k-d tree, its smoothed points and its rim.

    On the rim all neighbors lie on one side: their mean is off by more than 0.35 of their mean
    distance, along the surface.
    """
    points, normals = level.points, level.normals
    index = NeighborIndex(points)
    neighbor, _ = index.knn(points, min(neighbors, len(points)))
    offset = gather(points, neighbor) - points[:, None]
    height = (offset * normals[:, None]).sum(-1)
    along = offset - height[..., None] * normals[:, None]
    lean = along.mean(1).norm(dim=-1)
    interior = lean < 0.35 * along.norm(dim=-1).mean(1)
    smooth = points + height.mean(1, keepdim=True) * normals
    variation = (height - height.mean(1, keepdim=True)).square().mean(1) / along.square().sum(
        -1
    ).mean(1).clamp_min(1e-12)
    return Surface(points, smooth, normals, variation.sqrt(), interior, index, descriptors)


def measure(
    T_target_source: Float[Tensor, "k 4 4"], source: Surface, target: Surface, *, spacing: float
) -> Float[Tensor, "k 2 f"]:
    R, t = T_target_source[:, :3, :3], T_target_source[:, :3, 3]

    def to_target(x: Tensor) -> Tensor:
        return x @ R.mT + t[:, None]

    def to_source(x: Tensor) -> Tensor:
        return (x - t[:, None]) @ R

    forward = _one_side(
        to_target(source.points), to_target(source.smooth), source.normals @ R.mT, source, target, spacing
    )
    back = _one_side(
        to_source(target.points), to_source(target.smooth), target.normals @ R, target, source, spacing
    )
    return torch.stack([forward, back], 1)


def _one_side(moved, moved_smooth, moved_normals, own: Surface, surface: Surface, h: float):
    k, n, _ = moved.shape
    partner, distance = surface.index.nearest(moved.reshape(-1, 3))
    partner, distance = partner.view(k, n), distance.view(k, n)
    d = distance / h
    normal = surface.normals[partner]
    height = ((moved - surface.points[partner]) * normal).sum(-1).abs()
    smooth = ((moved_smooth - surface.smooth[partner]) * normal).sum(-1).abs() / h
    near = (d < 1.5).to(d.dtype)
    count = near.sum(-1).clamp_min(1)
    def over(x): return (x * near).sum(-1) / count
    plane = (height / h).clamp_max(1).square()
    cosine = (moved_normals * normal).sum(-1).abs()
    curv = (own.variation - surface.variation[partner]).abs()
    desc = (own.descriptors * surface.descriptors[partner]).sum(-1)
    above = surface.interior[partner] & (height > 0.5 * distance) & (d > 1)
    def share(x): return x.to(d.dtype).mean(-1)
    return torch.stack(
        [
            d.clamp_max(0.25).square().mean(-1),
            d.clamp_max(0.5).square().mean(-1),
            d.clamp_max(1.0).square().mean(-1),
            d.clamp_max(2.0).square().mean(-1),
            over(plane),
            over(smooth.clamp_max(0.15).square()),
            over(smooth.clamp_max(0.5).square()),
            over(smooth.clamp_max(1.0).square()),
            over(1 - cosine),
            over(curv),
            over(1 - desc),
            share(d < 1.5),
            share((d < 1.0) & (smooth < 0.2)),
            share(above & (distance > 0.05) & (distance < 0.25)),
            share(above & (distance > 0.025) & (distance < 0.1)),
            share((d < 1.5) & (smooth > 0.5)),
        ],
        -1,
    )
