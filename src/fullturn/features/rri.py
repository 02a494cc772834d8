"""Rigorously rotation-invariant representation (RRI): a neighborhood seen from the cloud's center.

After Chen et al., "ClusterNet" (CVPR 2019), with the tangent projection done exactly.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from fullturn.errors import InputError
from fullturn.features.coordinates import delta_xyz
from fullturn.geometry.normals import perpendicular


def rri(
    points: Float[Tensor, "*batch n 3"],
    neighbor_index: Int[Tensor, "*batch n k"],
    *,
    center: Float[Tensor, "*batch 3"] | None = None,
) -> Float[Tensor, "*batch n k 4"]:
    """|p|, |q|, θ and φ of each neighbor q of each point p, both seen from `center`.

    θ is the angle at the center between p and q (rad, [0, π]). φ is the smallest positive angle
    about p, right-handed, from q's projection to the plane perpendicular to p to that of another
    neighbor (rad, (0, 2π)): with the tangent angles sorted, the gap to the next one.

    A neighbor without a tangent direction (the point itself, one straight above or below it, a
    missing one) has φ = 0 and counts for no other; so has a neighbor that is the only one with a
    direction, and every neighbor of a point at the center. `center` defaults to the mean of the
    points, which makes the result invariant to translation too.

    Raises InputError for fewer than two neighbors: φ compares them.
    """
    if neighbor_index.shape[-1] < 2:
        raise InputError(
            f"rri compares neighbors and needs at least 2 per point, got {neighbor_index.shape[-1]}"
        )
    if center is None:
        center = points.mean(-2)
    p = points - center[..., None, :]
    # q and d = q − p have the same tangent projection, and d loses no digits where q is near p.
    d = delta_xyz(points, neighbor_index).movedim(-1, 0).contiguous()
    p = p.movedim(-1, 0)[..., None].contiguous()
    q = p + d
    p_length = p.square().sum(0).sqrt()
    q_length = q.square().sum(0).sqrt()
    cross_length = torch.linalg.cross(p.expand_as(q), q, dim=0).square().sum(0).sqrt()
    theta = torch.atan2(cross_length, (p * q).sum(0))
    phi = _turn_to_next(*_tangent(p / torch.where(p_length > 0, p_length, 1.0), d))
    return torch.stack([p_length.expand_as(q_length), q_length, theta, phi], dim=-1)


def _tangent(axis: Tensor, d: Tensor) -> tuple[Tensor, Tensor]:
    """Angle of d about a unit axis, from an arbitrary zero, and where d has such an angle."""
    e1 = perpendicular(axis)
    e2 = torch.linalg.cross(axis, e1, dim=0)
    along_1, along_2 = (d * e1).sum(0), (d * e2).sum(0)
    flat_sq = along_1.square() + along_2.square()
    # Below this share of |d| the direction is nothing but rounding.
    tolerance = 64 * torch.finfo(d.dtype).eps
    return torch.atan2(along_2, along_1), flat_sq > tolerance**2 * d.square().sum(0)


def _turn_to_next(angle: Tensor, valid: Tensor) -> Tensor:
    """Gap from each angle to the next greater one in a full turn, in O(k log k).

    Angles that differ by rounding are one: each of them has the gap to the next of another
    direction, so that points in a row as seen from their neighbor give no gap of 0 in one pose and
    none in another. 0 where there is no other direction.
    """
    same = 1024 * torch.finfo(angle.dtype).eps
    ordered, order = torch.where(valid, angle, math.inf).sort(dim=-1, stable=True)
    place = torch.arange(angle.shape[-1], device=angle.device)
    last = valid.sum(-1, keepdim=True) - 1
    first = ordered[..., :1]
    following = torch.where(place == last, first + 2 * math.pi, ordered.roll(-1, dims=-1))
    # Of each angle, the place where its direction ends in the sorted list.
    ends = torch.where(following - ordered <= same, angle.shape[-1], place)
    end = ends.flip(-1).cummin(-1).values.flip(-1)
    # The list is a circle: a direction that runs over its end ends where the first one does.
    around = end == angle.shape[-1]
    end = torch.where(around, end[..., :1], end).clamp_max(angle.shape[-1] - 1)
    following = following.gather(-1, end) + torch.where(around, 2 * math.pi, 0.0)
    has_other = (place <= last) & (end[..., :1] < last)
    gap = torch.where(has_other, following - ordered, 0.0)
    return torch.zeros_like(gap).scatter_(-1, order, gap)
