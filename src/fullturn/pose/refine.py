"""Robust iterative closest point for many poses at once, on nearest-point grids."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.geometry.motion import adjoint, invert, small_motion
from fullturn.pose.grid import NearestGrid
from fullturn.pose.kabsch import weighted_kabsch
from fullturn.pose.planes import move_planes, squared_falloff
from fullturn.pose.residuals import gauss_newton_step, plane_equations

# Holds back sliding along a surface, where planes leave a pose free.
_DAMPING = 0.01
# Of the points, those that have to lie on one of the other cloud: of independent samples of one
# surface, a few of a hundred are as close by chance.
_SHARE_ON_POINTS, _LEAST_ON_POINTS = 0.2, 6
_LAYING_SHARES = (1.0, 0.1, 0.01)  # narrower each time: a wrong partner may be as close at first
_GRAZING = -0.1  # cosine down to which a surface still counts as facing the eye


def refine_poses(
    T_target_source: Float[Tensor, "k 4 4"],
    source: Float[Tensor, "n 3"],
    target: Float[Tensor, "m 3"],
    source_grid: NearestGrid,
    target_grid: NearestGrid,
    *,
    scales: tuple[float, ...],
    seen: Bool[Tensor, "k n"] | None = None,
    eye: Float[Tensor, "k 3"] | None = None,
) -> Float[Tensor, "k 4 4"]:
    """Each pose moved towards the nearest local optimum, both clouds pulling.

    One Gauss–Newton step per entry of `scales` (lengths, from coarse to fine). A point counts with
    the weight (1 − d²/scale²)² (Tukey) within the scale and is drawn to the tangent plane of its
    partner. Source points look for partners in the target and target points in the source, so that
    neither cloud's gaps decide.

    Where the source is a whole model and the target a scan of it: only source points that a pose
    shows (`seen`) count, and target points find partners only where the source faces the direction
    to the `eye`, in the source's frame: the far side of a thin wall must not draw its near side.
    """
    # Poses are so few that NumPy, whose calls cost less, takes half the time for all that isn't
    # done for every point.
    T = T_target_source.numpy(force=True).astype(np.float64)
    points, partners = source.T.contiguous(), target.T.contiguous()
    for scale in scales:
        moved = move_planes(torch.from_numpy(T).to(source), points)
        difference, normal = target_grid.nearest(moved)
        weight = tukey(difference, scale)
        if seen is not None:
            weight = weight * seen
        H, g = _in_numpy(plane_equations(moved, difference, normal, weight))
        # In the source's frame it is the partner that moves, by what the motion is there.
        T_source_target = invert(T)
        back = move_planes(torch.from_numpy(T_source_target).to(target), partners)
        difference, normal = source_grid.nearest(back)
        weight = tukey(difference, scale)
        if eye is not None:
            weight = weight * ((normal * eye.T.unsqueeze(-1)).sum(0) > _GRAZING)
        H_back, g_back = _in_numpy(
            plane_equations(back - difference, difference.neg_(), normal, weight)
        )
        there = adjoint(T_source_target)
        across = np.swapaxes(there, -1, -2)
        H = H + across @ H_back @ there
        g = g + (across @ g_back[..., None])[..., 0]
        T = small_motion(gauss_newton_step(H, g, damping=_DAMPING)) @ T
    return torch.from_numpy(T).to(T_target_source)


def lay_on_points(
    T_target_source: Float[Tensor, "k 4 4"],
    source: Float[Tensor, "n 3"],
    target_grid: NearestGrid,
    *,
    close: float,
) -> Float[Tensor, "k 4 4"]:
    """Poses that lay points within `close` of points of the other cloud, exactly on them.

    The others are left as they are.
    Tangent planes leave a rest that depends on the way that a pose came. Where clouds share one
    sampling and next to no noise, that rest would tell poses apart that are equally good.
    """
    T = T_target_source.clone()
    planes = source.T.contiguous()
    for share in _LAYING_SHARES:
        moved = move_planes(T, planes)
        difference = target_grid.difference(moved)
        on_point = difference.square().sum(0) < (share * close) ** 2
        exact = on_point.sum(1) > max(_LEAST_ON_POINTS, _SHARE_ON_POINTS * len(source))
        if not bool(exact.any()):
            break
        partner = (moved - difference).movedim(0, -1)[exact]
        weight = on_point[exact].to(source.dtype)
        T[exact] = weighted_kabsch(source.expand_as(partner), partner, weight)
    return T


def tukey(difference: Float[Tensor, " 3 *batch"], scale: float) -> Float[Tensor, "*batch"]:
    """(1 − d²/scale²)² within the scale, 0 beyond."""
    return squared_falloff(difference.square().sum(0), scale).square_()


def _in_numpy(tensors: tuple[Tensor, Tensor]) -> tuple[np.ndarray, np.ndarray]:
    first, second = tensors
    return first.numpy(force=True), second.numpy(force=True)
