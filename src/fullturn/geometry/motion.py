"""Rigid motions as NumPy arrays; `rigid` has those of tensors, with their derivatives."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def rigid(
    rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """The 4×4 motion ``x ↦ R·x + t``."""
    motion = np.eye(4)
    motion[:3, :3] = rotation
    motion[:3, 3] = translation
    return motion


def invert(motion: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, "*batch 4 4"]:
    """The inverses of rigid motions, [Rᵀ, −Rᵀt]."""
    inverse = np.zeros(motion.shape)
    inverse[..., :3, :3] = back = np.swapaxes(motion[..., :3, :3], -1, -2)
    inverse[..., :3, 3] = -(back @ motion[..., :3, 3, None])[..., 0]
    inverse[..., 3, 3] = 1.0
    return inverse


def move(
    motion: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "*n 3"]
) -> Float[np.ndarray, "*n 3"]:
    """The points after the motion, ``points @ R.T + t``."""
    return points @ motion[:3, :3].T + motion[:3, 3]


def rotation_angle_deg(rotation: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch"]:
    """The angle of each rotation, in [0, 180].

    arccos((tr − 1)/2) in its atan2 form, which keeps its digits near 0° and near 180°.

    >>> float(rotation_angle_deg(np.diag([-1.0, -1.0, 1.0])))
    180.0
    """
    cosine_twice = np.trace(rotation, axis1=-2, axis2=-1) - 1.0
    twist = rotation - np.swapaxes(rotation, -1, -2)
    sine_twice = np.sqrt(twist[..., 2, 1] ** 2 + twist[..., 0, 2] ** 2 + twist[..., 1, 0] ** 2)
    return np.asarray(np.degrees(np.arctan2(sine_twice, cosine_twice)))


def nearest_rotation(matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """The rotation (determinant +1) that is nearest to a matrix in Frobenius norm."""
    left, _, right = np.linalg.svd(matrix)
    nearest: np.ndarray = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return nearest


def skew(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """[v]ₓ, so that ``skew(v) @ x`` is v × x."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def small_motion(step: Float[np.ndarray, "6"]) -> Float[np.ndarray, "4 4"]:
    """The motion of an optimizer's step (ω, v); `rigid.small_motion` says how."""
    half = 0.5 * step[:3]
    K = skew(half)
    return rigid(np.eye(3) + 2.0 / (1.0 + half @ half) * (K + K @ K), step[3:])
