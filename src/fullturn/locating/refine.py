"""Iterative closest point between a scan and what it can see of a model, for many poses at once."""

from __future__ import annotations

from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.pose.grid import NearestGrid
from fullturn.pose.refine import tukey
from fullturn.pose.residuals import gauss_newton_step, normal_equations

_DAMPING = 0.01
_GRAZING = -0.1  # cosine down to which a surface still counts as facing the eye


def refine_visible(
    T_scene_model: Float[Tensor, "k 4 4"],
    model: Float[Tensor, "m 3"],
    scene: Float[Tensor, "n 3"],
    model_grid: NearestGrid,
    scene_grid: NearestGrid,
    *,
    seen: Bool[Tensor, "k m"],
    direction: Float[Tensor, "k 3"],
    scales: tuple[float, ...],
) -> Float[Tensor, "k 4 4"]:
    """Each pose moved towards the nearest local optimum, hidden surfaces left out.

    As `pose.refine.refine_poses`, but of the model only what is `seen` looks for partners in the
    scene, and the scene finds partners only where the model faces the eye in `direction` (model
    frame): the far side of a thin wall must not draw its near side.
    """
    T = T_scene_model
    for scale in scales:
        R, t = T[:, :3, :3], T[:, None, :3, 3]
        moved = model @ R.mT + t
        difference, normal = scene_grid.nearest(moved)
        weight = tukey(difference, scale) * seen
        H, g = normal_equations(moved, difference, normal, weight)
        # Backwards, the moving point is the model's: it lies at scene − difference.
        difference, normal = model_grid.nearest((scene - t) @ R)
        facing = (normal @ direction[..., None])[..., 0] > _GRAZING
        weight = tukey(difference, scale) * facing
        difference, normal = difference @ R.mT, normal @ R.mT
        H_back, g_back = normal_equations(scene - difference, -difference, normal, weight)
        T = rigid.exp_se3(gauss_newton_step(H + H_back, g + g_back, damping=_DAMPING)) @ T
    return T
