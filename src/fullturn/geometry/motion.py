"""Rigid motions as NumPy arrays; `rigid` has those of tensors, with their derivatives."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def rigid(
    rotation: Float[np.ndarray, "*batch 3 3"], translation: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch 4 4"]:
    """The 4×4 motions ``x ↦ R·x + t``."""
    motion = np.zeros((*rotation.shape[:-2], 4, 4))
    motion[..., :3, :3] = rotation
    motion[..., :3, 3] = translation
    motion[..., 3, 3] = 1.0
    return motion


def invert(motion: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, "*batch 4 4"]:
    """The inverses of rigid motions, [Rᵀ, −Rᵀt]."""
    back = np.swapaxes(motion[..., :3, :3], -1, -2)
    return rigid(back, -(back @ motion[..., :3, 3, None])[..., 0])


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


def skew(vector: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3 3"]:
    """[v]ₓ, so that ``skew(v) @ x`` is v × x."""
    matrix = np.zeros((*vector.shape, 3))
    x, y, z = np.moveaxis(vector, -1, 0)
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -z, y, -x
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = z, -y, x
    return matrix


def adjoint(T_a_b: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, "*batch 6 6"]:
    """Takes a small motion (ω, v) in frame b to the same one in frame a: (Rω, t × Rω + Rv)."""
    R = T_a_b[..., :3, :3]
    result = np.zeros((*R.shape[:-2], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = R
    result[..., 3:, :3] = skew(T_a_b[..., :3, 3]) @ R
    return result


def small_motion(step: Float[np.ndarray, "*batch 6"]) -> Float[np.ndarray, "*batch 4 4"]:
    """The motion x → R x + v of an optimizer's step (ω, v).

    R = (I − [ω/2]ₓ)⁻¹ (I + [ω/2]ₓ) (Cayley), which turns by ω but for terms of the third order.
    """
    half = 0.5 * step[..., :3]
    K = skew(half)
    scale = 2.0 / (1.0 + np.square(half).sum(-1))
    return rigid(np.eye(3) + scale[..., None, None] * (K + K @ K), step[..., 3:])
