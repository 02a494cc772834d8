"""Robust iterative closest point for many poses at once, on nearest-point grids."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.pose.grid import NearestGrid
from fullturn.pose.residuals import gauss_newton_step, normal_equations

# Holds back sliding along a surface, where planes leave a pose free.
_DAMPING = 0.01


def refine_poses(
    T_target_source: Float[Tensor, "k 4 4"],
    source: Float[Tensor, "n 3"],
    target: Float[Tensor, "m 3"],
    source_grid: NearestGrid,
    target_grid: NearestGrid,
    *,
    scales: tuple[float, ...],
) -> Float[Tensor, "k 4 4"]:
    """Each pose moved towards the nearest local optimum, both clouds pulling.

    One Gauss–Newton step per entry of `scales` (lengths, from coarse to fine). A point counts with
    the weight (1 − d²/scale²)² (Tukey) within the scale and is drawn to the tangent plane of its
    partner. Source points look for partners in the
    target and target points in the source, so that neither cloud's gaps decide.
    """
    T = T_target_source
    for scale in scales:
        R, t = T[:, :3, :3], T[:, None, :3, 3]
        moved = source @ R.mT + t
        difference, normal = target_grid.nearest(moved)
        H, g = normal_equations(moved, difference, normal, tukey(difference, scale))
        # Backwards, the moving point is the source's: it lies at target − difference.
        difference, normal = source_grid.nearest((target - t) @ R)
        weight = tukey(difference, scale)
        difference, normal = difference @ R.mT, normal @ R.mT
        H_back, g_back = normal_equations(target - difference, -difference, normal, weight)
        T = rigid.exp_se3(gauss_newton_step(H + H_back, g + g_back, damping=_DAMPING)) @ T
    return T


def tukey(difference: Float[Tensor, "*batch n 3"], scale: float) -> Float[Tensor, "*batch n"]:
    """(1 − d²/scale²)² within the scale, 0 beyond."""
    return (1 - difference.square().sum(-1) / scale**2).clamp_min_(0).square_()
