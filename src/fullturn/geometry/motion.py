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
