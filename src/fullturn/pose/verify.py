"""What tells a right pose from a wrong one, measured on both clouds."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.geometry.neighbors import NeighborIndex, gather


@dataclass(frozen=True, eq=False)
class Surface:
    """A cloud prepared for verification."""

    points: Float[Tensor, "n 3"]
    normals: Float[Tensor, "n 3"]
    interior: Bool[Tensor, " n"]  # False on the rim of a partial cloud
    index: NeighborIndex


def prepare_surface(
    points: Float[Tensor, "n 3"], normals: Float[Tensor, "n 3"], *, neighbors: int = 16
) -> Surface:
    """The cloud with its k-d tree, and which points lie inside rather than on the rim.

    On the rim all neighbors lie on one side: their mean is off by more than 0.35 of their mean
    distance, along the surface.
    """
    index = NeighborIndex(points)
    neighbor, _ = index.knn(points, min(neighbors, len(points)))
    offset = gather(points, neighbor) - points[:, None]
    offset = offset - (offset * normals[:, None]).sum(-1, keepdim=True) * normals[:, None]
    lean = offset.mean(1).norm(dim=-1)
    interior = lean < 0.35 * offset.norm(dim=-1).mean(1)
    return Surface(points, normals, interior, index)


FEATURES = (
    "log_distance_fine",
    "log_distance_medium",
    "log_distance_coarse",
    "log_distance_worse_side",
    "log_plane_residual",
    "normal_disagreement",
    "overlap_smaller",
    "overlap_larger",
    "conflict",
    "conflict_near",
)


def measure(
    T_target_source: Float[Tensor, "k 4 4"],
    source: Surface,
    target: Surface,
    *,
    spacing: float,
) -> Float[Tensor, "k f"]:
    """One row of `FEATURES` per pose. `spacing` is the point spacing of the coarser cloud (h).

    Distances are to the nearest point of the other cloud, in units of h:
    mean of min(d, τ)² for τ = 0.5, 1, 2 h (logarithm, both sides averaged), and the worse side at
    1 h; the distance to the tangent plane and the angle between normals where d < 1.5 h; the share
    of points with d < 1.5 h (smaller and larger side); conflict: the share of points that hang
    0.05–0.25 (near: 0.025–0.1) above an interior point of the other cloud, where a surface should
    have been seen.
    """
    R, t = T_target_source[:, :3, :3], T_target_source[:, :3, 3]
    forward = _one_side(source.points @ R.mT + t[:, None], source.normals @ R.mT, target, spacing)
    back = _one_side(
        (target.points - t[:, None]) @ R, target.normals @ R, source, spacing
    )
    both = (forward + back) / 2
    d_fine, d_medium, d_coarse, plane, normal, overlap, conflict, conflict_near = both.unbind(-1)
    worse = torch.maximum(forward[:, 1], back[:, 1])
    smaller = torch.minimum(forward[:, 5], back[:, 5])
    larger = torch.maximum(forward[:, 5], back[:, 5])
    return torch.stack(
        [
            _log(d_fine),
            _log(d_medium),
            _log(d_coarse),
            _log(worse),
            _log(plane),
            normal,
            smaller,
            larger,
            conflict,
            conflict_near,
        ],
        -1,
    )


def _one_side(
    moved: Float[Tensor, "k n 3"],
    moved_normals: Float[Tensor, "k n 3"],
    surface: Surface,
    spacing: float,
) -> Float[Tensor, "k 8"]:
    k, n, _ = moved.shape
    partner, distance = surface.index.nearest(moved.reshape(-1, 3))
    partner, distance = partner.view(k, n), distance.view(k, n)
    d = distance / spacing
    difference = moved - surface.points[partner]
    normal = surface.normals[partner]
    height = (difference * normal).sum(-1).abs()
    near = (d < 1.5).to(d.dtype)
    count = near.sum(-1).clamp_min(1)
    plane = ((height / spacing).clamp_max(1).square() * near).sum(-1) / count
    cosine = (moved_normals * normal).sum(-1).abs()
    disagreement = ((1 - cosine) * near).sum(-1) / count
    above = surface.interior[partner] & (height > 0.5 * distance)
    conflict = above & (distance > 0.05) & (distance < 0.25) & (d > 1)
    conflict_near = above & (distance > 0.025) & (distance < 0.1) & (d > 1)
    return torch.stack(
        [
            d.clamp_max(0.5).square().mean(-1),
            d.clamp_max(1.0).square().mean(-1),
            d.clamp_max(2.0).square().mean(-1),
            plane,
            disagreement,
            near.mean(-1),
            conflict.to(d.dtype).mean(-1),
            conflict_near.to(d.dtype).mean(-1),
        ],
        -1,
    )


def _log(value: Float[Tensor, " k"]) -> Float[Tensor, " k"]:
    return (value + 1e-6).log()
