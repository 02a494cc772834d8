"""Robust iterative closest point, for many poses at once on nearest-point grids."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.pose.grid import NearestGrid


def refine_poses(
    T_target_source: Float[Tensor, "k 4 4"],
    source: Float[Tensor, "n 3"],
    target: Float[Tensor, "m 3"],
    source_grid: NearestGrid,
    target_grid: NearestGrid,
    *,
    scales: tuple[float, ...],
    point_weight: float = 0.05,
) -> Float[Tensor, "k 4 4"]:
    """Each pose moved towards the nearest local optimum, both clouds pulling.

    One Gauss–Newton step per entry of `scales` (lengths, from coarse to fine). A point counts with
    the weight (1 − d²/scale²)² (Tukey) within the scale. The residual is the distance to the
    tangent plane of the partner, plus `point_weight` times the distance to the partner itself,
    which holds what planes leave free. Source points look for partners in the target and target
    points in the source, so that neither cloud's gaps decide.
    """
    T = T_target_source
    for scale in scales:
        R, t = T[:, :3, :3], T[:, :3, 3]
        # Source points, moved; perturbation x → x + ω × x + v in the target frame.
        moved = source @ R.mT + t[:, None]
        difference, normal = target_grid.nearest(moved)
        H, g = _normal_equations(moved, difference, normal, scale, point_weight)
        # Target points against the moved source: partner and normal go to the target frame.
        back = (target - t[:, None]) @ R
        difference, normal = source_grid.nearest(back)
        difference, normal = difference @ R.mT, normal @ R.mT
        H_back, g_back = _normal_equations(target - difference, -difference, normal, scale, point_weight)
        step = _solve(H + H_back, g + g_back)
        T = rigid.exp_se3(step) @ T
    return T


def _normal_equations(
    at: Float[Tensor, "k n 3"],
    difference: Float[Tensor, "k n 3"],
    normal: Float[Tensor, "k n 3"],
    scale: float,
    point_weight: float,
) -> tuple[Float[Tensor, "k 6 6"], Float[Tensor, "k 6"]]:
    """Σ w JᵀJ and Σ w Jᵀr for a motion (ω, v) of the points `at`."""
    weight = (1 - difference.square().sum(-1) / scale**2).clamp_min_(0).square_()
    plane = torch.cat([torch.linalg.cross(at, normal), normal], -1)
    residual = (difference * normal).sum(-1)
    weighted = plane * weight.unsqueeze(-1)
    H = weighted.mT @ plane
    g = (weighted.mT @ residual.unsqueeze(-1)).squeeze(-1)
    # The point-to-point part in closed form: J = [−[x]×, I].
    w = weight * point_weight
    total = w.sum(-1)
    mean = (w.unsqueeze(-1) * at).sum(-2)
    pull = (w.unsqueeze(-1) * difference).sum(-2)
    moment = (w.unsqueeze(-1) * at).mT @ at
    trace = moment.diagonal(dim1=-2, dim2=-1).sum(-1)
    eye = torch.eye(3, dtype=at.dtype, device=at.device)
    H[:, :3, :3] += trace[:, None, None] * eye - moment
    cross = _skew(mean)
    H[:, :3, 3:] += cross
    H[:, 3:, :3] += cross.mT
    H[:, 3:, 3:] += total[:, None, None] * eye
    g[:, :3] += (w.unsqueeze(-1) * torch.linalg.cross(at, difference)).sum(-2)
    g[:, 3:] += pull
    return H, g


def _solve(H: Float[Tensor, "k 6 6"], g: Float[Tensor, "k 6"]) -> Float[Tensor, "k 6"]:
    """−H⁻¹g, damped a little; zero where nothing pulls."""
    size = H.diagonal(dim1=-2, dim2=-1).mean(-1)
    damping = (1e-4 * size + 1e-9)[:, None, None] * torch.eye(6, dtype=H.dtype, device=H.device)
    return -torch.linalg.solve(H + damping, g.unsqueeze(-1)).squeeze(-1).clamp(-0.5, 0.5)


def _skew(v: Float[Tensor, "k 3"]) -> Float[Tensor, "k 3 3"]:
    x, y, z = v.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).view(-1, 3, 3)
