"""Other libraries' poses, made rigid."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fullturn.geometry.motion import nearest_rotation, rigid


def rigid_or(
    T_target_source: Float[np.ndarray, "4 4"], T_otherwise: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "4 4"]:
    """The pose with its rotation made one to the last digit; the other one where it isn't finite.

    Libraries return rotations in float32, or the NaN of a singular system.
    """
    for T in (T_target_source, T_otherwise):
        if np.isfinite(T).all():
            return rigid(nearest_rotation(T[:3, :3]), T[:3, 3])
    return np.eye(4)
