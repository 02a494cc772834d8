"""Where a cloud lies and how large it is, whatever stray points it has."""

from __future__ import annotations

import numpy as np

# Robust against a few stray points, and all but the radius of a clean cloud.
_RADIUS_QUANTILE = 0.99
_STRAY = 10.0  # radii from the mean: no point of the object lies there


def center_and_radius(points: np.ndarray) -> tuple[np.ndarray, float]:
    """The mean (3,) of points (n, 3) and their radius, in their unit.

    The radius is the 99th percentile of the distances to the mean, so that a few stray points don't
    shrink the rest. Where it is small beside the largest distance, copies count once in it, for
    most of the points may coincide, and points more than ten radii away, in neither.
    """
    center, distance = _distances(points)
    radius = _radius(distance)
    if distance.max() <= _STRAY * radius:
        return center, radius
    kept = distinct = np.unique(points, axis=0)
    while True:
        mean, distance = _distances(kept)
        radius = _radius(distance)
        near = distance <= _STRAY * radius
        if near.all():
            return (center if kept is distinct else mean), radius
        kept = kept[near]


def far_from_the_rest(points: np.ndarray, center: np.ndarray, radius: float) -> np.ndarray:
    """Which points (n, 3) no object of this center and radius has: bool (n,)."""
    far: np.ndarray = np.linalg.norm(points - center, axis=1) > _STRAY * radius
    return far


def strays(points: np.ndarray) -> np.ndarray:
    """Which points (n, 3) are far from the rest of their cloud: bool (n,)."""
    return far_from_the_rest(points, *center_and_radius(points))


def _distances(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # Taking one point off first keeps the mean exact far from the origin.
    center = points[0] + (points - points[0]).mean(axis=0)
    return center, np.linalg.norm(points - center, axis=1)


def _radius(distance: np.ndarray) -> float:
    return float(np.quantile(distance, _RADIUS_QUANTILE))
