"""What happens to a cloud before it is registered: noise, crops, resampling."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fullturn.data.motion import uniform_direction
from fullturn.errors import InputError


def jitter(
    points: Float[np.ndarray, "n 3"], rng: np.random.Generator, *, sigma: float, clip: float
) -> Float[np.ndarray, "n 3"]:
    """Add N(0, sigma) to every coordinate, clipped to ±clip; lengths in the cloud's unit."""
    return points + np.clip(rng.normal(0.0, sigma, points.shape), -clip, clip)


def far_viewpoint(rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    """The viewpoint of the ModelNet40 crop: v = u + 500·s·(1, 1, 1), u ~ U[0, 1]³, s = ±1."""
    corner = rng.uniform(0.0, 1.0, 3)
    sign = 1.0 if rng.integers(2) else -1.0
    return corner + 500.0 * sign


def crop_nearest(
    points: Float[np.ndarray, "n 3"], viewpoint: Float[np.ndarray, "3"], *, keep: int
) -> Float[np.ndarray, "keep 3"]:
    """The `keep` points nearest to a viewpoint, in their old order.

    From a far viewpoint this is a cut by a plane at right angles to the line of sight.
    """
    _check_enough(points, keep)
    distance_sq = np.square(points - viewpoint).sum(axis=1)
    return points[np.sort(np.argsort(distance_sq, kind="stable")[:keep])]


def crop_plane(
    points: Float[np.ndarray, "n 3"], rng: np.random.Generator, *, keep_share: float
) -> Float[np.ndarray, "m 3"]:
    """The ⌊share·n⌋ points on the far side of a plane with a uniform random normal."""
    if not 0.0 < keep_share <= 1.0:
        raise InputError(
            f"expected keep_share in (0, 1], got {keep_share}; pass the share of points to keep"
        )
    height = points @ uniform_direction(rng)
    keep = max(1, int(keep_share * len(points)))
    return points[np.sort(np.argsort(-height, kind="stable")[:keep])]


def resample(
    points: Float[np.ndarray, "n 3"], rng: np.random.Generator, *, count: int
) -> Float[np.ndarray, "count 3"]:
    """`count` different points of the cloud, drawn without replacement, in random order."""
    _check_enough(points, count)
    return points[rng.permutation(len(points))[:count]]


def _check_enough(points: np.ndarray, count: int) -> None:
    if count > len(points):
        raise InputError(
            f"expected at least {count} points, got {len(points)}; draw more or keep fewer"
        )
