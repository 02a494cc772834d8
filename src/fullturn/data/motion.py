"""Random rigid motions: one function per distribution, since the distributions differ."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation


def uniform_direction(rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    """A unit vector, uniform on the sphere."""
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def uniform_rotation(rng: np.random.Generator) -> Float[np.ndarray, "3 3"]:
    """A rotation, uniform on SO(3); its angle has mean 126.5°."""
    return Rotation.from_quat(rng.normal(size=4)).as_matrix()


def axis_angle_rotation(
    rng: np.random.Generator, *, max_angle_deg: float
) -> Float[np.ndarray, "3 3"]:
    """A rotation about a uniform axis by an angle ~ U[0, max].

    At 180° its mean is 90°, so this is *not* uniform on SO(3); see `uniform_rotation`.
    """
    axis = uniform_direction(rng)
    angle_rad = np.deg2rad(rng.uniform(0.0, max_angle_deg))
    return Rotation.from_rotvec(angle_rad * axis).as_matrix()


def euler_rotation(rng: np.random.Generator, *, max_angle_deg: float) -> Float[np.ndarray, "3 3"]:
    """R = Rx·Ry·Rz with the three angles ~ U[0, max] each."""
    return Rotation.from_euler("zyx", rng.uniform(0.0, max_angle_deg, 3), degrees=True).as_matrix()


def ball_translation(rng: np.random.Generator, *, max_length: float) -> Float[np.ndarray, "3"]:
    """A vector of uniform direction and of length ~ U[0, max]."""
    direction = uniform_direction(rng)
    return rng.uniform(0.0, max_length) * direction
