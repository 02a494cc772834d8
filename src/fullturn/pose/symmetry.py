"""Rotations of an object onto itself that would explain rival poses."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry import rigid

_SAME_AXIS_DEG = 12.0
_SAME_ANGLE_DEG = 8.0
_MAX_ORDER = 8
_LEAST_ENTRY = 5e-3  # of an axis: smaller ones, which two decimals don't show, decide no sign
_MANY = 4  # so many angles without a common step mean that any angle will do


@dataclass(frozen=True, eq=False)
class CloudSymmetry:
    """Rotations about one axis that leave the surface as it is."""

    axis: np.ndarray  # (3,) unit vector, source frame; the first non-zero entry is positive
    order: int  # n-fold; 0 where any angle will do


def symmetry_of_poses(
    T_best: Float[Tensor, "4 4"], T_rivals: Float[Tensor, "k 4 4"]
) -> CloudSymmetry | None:
    """The rotation symmetry of the source that would explain the rival poses, if one does.

    S = T_best⁻¹ T_rival moves the source onto itself. The axis that most rivals share is taken;
    n-fold where all its angles are multiples of 360°/n for an n up to 8, nearly all of which
    were seen; continuous where there are many other angles. None where fewer than half of the
    rivals share an axis (but for the half turns of a box), or their angles are no symmetry's.
    """
    motions = [rigid.invert(T_best) @ T for T in T_rivals]
    turns = [_axis_angle(motion) for motion in motions]
    turns = [(axis, angle) for axis, angle in turns if angle > math.radians(5.0)]
    if not turns:
        return None
    cosine = math.cos(math.radians(_SAME_AXIS_DEG))
    groups = [[turn for turn in turns if abs(float(turn[0] @ axis)) > cosine] for axis, _ in turns]
    shared = max(groups, key=len)
    if 2 * len(shared) < len(turns) and not _are_of_a_box(turns):
        return None
    order = _order([math.degrees(angle) for _, angle in shared])
    if order is None:
        return None
    axis, _ = shared[0]
    return CloudSymmetry(axis.numpy(force=True), order)


def _axis_angle(motion: Tensor) -> tuple[Tensor, float]:
    vector = rigid.log_so3(motion[:3, :3])
    angle = float(vector.norm())
    axis = vector / max(angle, 1e-12)
    leading = axis[torch.nonzero(axis.abs() > _LEAST_ENTRY)[0, 0]] if angle > 1e-9 else axis[0]
    return (axis if leading >= 0 else -axis), angle


def _are_of_a_box(turns: list[tuple[Tensor, float]]) -> bool:
    """Whether all are half turns, about the same axis or perpendicular ones."""
    axes = torch.stack([axis for axis, _ in turns])
    cosine = (axes @ axes.T).abs()
    apart = math.radians(_SAME_AXIS_DEG)
    square = (cosine > math.cos(apart)) | (cosine < math.sin(apart))
    least = math.pi - math.radians(_SAME_ANGLE_DEG)
    return bool(square.all()) and all(angle > least for _, angle in turns)


def _order(angles_deg: list[float]) -> int | None:
    """The n of an n-fold symmetry with these angles (0 to 180°), 0 for any angle, None for no."""
    for order in range(2, _MAX_ORDER + 1):
        step = 360.0 / order
        multiples = {round(angle / step) for angle in angles_deg}
        fits = all(abs(a - step * round(a / step)) < _SAME_ANGLE_DEG for a in angles_deg)
        if fits and 0 not in multiples and 2 * len(multiples) >= order - 1:
            return order
    return 0 if len(angles_deg) >= _MANY else None
