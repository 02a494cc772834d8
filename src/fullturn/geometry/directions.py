"""Directions to look from."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from fullturn.errors import InputError


def sphere_directions(count: int) -> Float[np.ndarray, "count 3"]:
    """`count` unit vectors, spread evenly over the sphere: a Fibonacci lattice.

    The k-th lies at height 1 − (2k + 1)/count, one golden angle around z from the one before
    (González, "Measurement of areas on a sphere using Fibonacci and latitude–longitude lattices",
    2010). The first half of an even number of them is the upper half of the sphere.
    """
    if count < 1:
        raise InputError(f"count: expected at least 1 direction, got {count}")
    step = np.arange(count)
    z = 1.0 - (2.0 * step + 1.0) / count
    angle_rad = step * (math.pi * (3.0 - math.sqrt(5.0)))
    ring = np.sqrt(1.0 - z**2)
    return np.stack([ring * np.cos(angle_rad), ring * np.sin(angle_rad), z], axis=1)
