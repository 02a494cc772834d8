"""Two clouds' closest points at a pose, and the least-squares problem that their noise makes of it.

In NumPy, as it is done for one pose after another: see `NearestTracker`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fullturn.geometry.cloud import Cloud
from fullturn.geometry.motion import skew
from fullturn.geometry.neighbors import NearestTracker

# Where points aren't trusted to be the same ones, and where they fully are: the share of mutual
# nearest neighbors, and the deviation across the surface in that along it. Two samplings of a
# surface have few of the first, unless both are even; and without much noise, far less of the
# second than the noise of one and the same points, which is as large in all directions.
_MUTUAL, _ALONG = (0.54, 0.66), (0.5, 0.75)
_LEAST_POINT_SHARE = 0.01
_FEWEST_PAIRS = 6


@dataclass(frozen=True, eq=False)
class Residuals:
    """The weighted least-squares problem at one pose, in the source frame (right perturbation)."""

    H: Float[np.ndarray, "6 6"]  # in units of 1/σ²: an information matrix, both directions counted
    g: Float[np.ndarray, "6"]
    sigma_normal: float  # off the surface, robust
    sigma_tangent: float  # along the surface, per axis, robust
    trust: float  # that a partner is the same physical point, 0 to 1
    point_share: float  # of the weight along the surface in that across it
    reach: float  # three deviations: how far apart partners may lie


class ClosestPairs:
    """Points of both samples, each with the nearest point of the other cloud, at pose after pose.

    Of the samples, one in `every` points is taken.
    """

    def __init__(self, source: Cloud, target: Cloud, *, every: int = 1) -> None:
        self._source, self._target = (cloud.points.numpy(force=True) for cloud in (source, target))
        self._own, self._others = (
            cloud.sample[::every].numpy(force=True) for cloud in (source, target)
        )
        self._own_normals, self._other_normals = (
            cloud.sample_normals[::every].numpy(force=True) for cloud in (source, target)
        )
        self._to_target = NearestTracker(target.index)
        self._to_source, self._back = NearestTracker(source.index), NearestTracker(source.index)

    def residuals(self, T_target_source: Float[np.ndarray, "4 4"], *, cutoff: float) -> Residuals:
        """Of the pairs that lie less than `cutoff` apart, weighed by their noise."""
        R, t = T_target_source[:3, :3], T_target_source[:3, 3]
        partner = self._to_target.nearest(self._own @ R.T + t, within=cutoff)
        y = (self._target[partner] - t) @ R
        back = self._back.nearest(y, within=cutoff)
        pulled = (self._others - t) @ R
        x = self._source[self._to_source.nearest(pulled, within=cutoff)]
        difference = np.concatenate([self._own - y, x - pulled])
        near = np.einsum("ij,ij->i", difference, difference) < cutoff**2
        paired = np.flatnonzero(near)
        if len(paired) < _FEWEST_PAIRS:
            return Residuals(np.zeros((6, 6)), np.zeros(6), cutoff, cutoff, 0.0, 1.0, cutoff)
        at = np.concatenate([self._own, x])
        normal = np.concatenate([self._own_normals, self._other_normals @ R])
        # Coordinates come first from here on.
        at, difference, normal = (
            np.ascontiguousarray(rows[paired].T) for rows in (at, difference, normal)
        )

        height = (difference * normal).sum(0)
        along = np.sqrt(np.square(difference - height * normal).sum(0))
        tiny = 1e-12
        # Medians: of |N(0, σ²)| it is 0.6745 σ, of a length in two dimensions 1.1774 σ.
        sigma_normal = _median(np.abs(height)) / 0.6745 + tiny
        sigma_tangent = _median(along) / 1.1774 + tiny
        forward = near[: len(y)]
        mutual = (self._source[back] == self._own).all(1)[forward]
        share = float(mutual.mean()) if len(mutual) else 0.0
        ratio = sigma_normal / sigma_tangent
        trust = _ramp(share, *_MUTUAL) * _ramp(ratio, *_ALONG)
        point_share = max(_LEAST_POINT_SHARE, trust) * min(1.0, ratio**2)
        reach = min(cutoff, 3.0 * (sigma_normal**2 + 2.0 * sigma_tangent**2) ** 0.5)
        # Tukey on the two variances; a pair three deviations off across the surface counts nothing.
        unlikely = np.square(height / (4.0 * sigma_normal)) + np.square(along / reach)
        weight = np.square(np.maximum(1.0 - unlikely, 0.0)) / sigma_normal**2
        H, g = normal_equations(at, difference, normal, weight, point_share=point_share)
        return Residuals(H, g, sigma_normal, sigma_tangent, trust, point_share, reach)


def normal_equations(
    at: Float[np.ndarray, "3 n"],
    difference: Float[np.ndarray, "3 n"],
    normal: Float[np.ndarray, "3 n"],
    weight: Float[np.ndarray, " n"],
    *,
    point_share: float,
) -> tuple[Float[np.ndarray, "6 6"], Float[np.ndarray, "6"]]:
    """H = Σ w JᵀWJ and g = Σ w JᵀWr of a small motion (ω, v) of the points: x → x + ω × x + v.

    r is the `difference` between a point and its partner, J = [−[x]×, I], and
    W = (1 − p) n nᵀ + p I with p = `point_share`: 0 is point-to-plane, 1 is point-to-point, between
    them sliding along the surface costs p times what leaving it costs. The planes' part is one
    product of rows [x × n, n, n·r], the points' part follows from the moments of [1, x, r].
    """
    (x, y, z), (nx, ny, nz) = at, normal
    rows = np.empty((7, at.shape[1]))
    rows[0], rows[1], rows[2] = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
    rows[3:6], rows[6] = normal, (difference * normal).sum(0)
    planes = (rows * weight) @ rows.T
    rows[0], rows[1:4], rows[4:] = 1.0, at, difference
    moments = (rows[:4] * weight) @ rows.T
    second, product, lever = moments[1:, 1:4], moments[1:, 4:], skew(moments[0, 1:4])
    H = np.empty((6, 6))
    H[:3, :3] = np.trace(second) * np.eye(3) - second
    H[:3, 3:], H[3:, :3] = lever, lever.T
    H[3:, 3:] = moments[0, 0] * np.eye(3)
    twist = product - product.T
    g = np.array([twist[1, 2], twist[2, 0], twist[0, 1], *moments[0, 4:]])
    return (
        (1 - point_share) * planes[:6, :6] + point_share * H,
        (1 - point_share) * planes[:6, 6] + point_share * g,
    )


def _ramp(value: float, low: float, high: float) -> float:
    """0 up to `low`, 1 from `high` on, linear between."""
    return min(1.0, max(0.0, (value - low) / (high - low)))


def _median(values: Float[np.ndarray, " n"]) -> float:
    """The lower one of an even number."""
    middle = (len(values) - 1) // 2
    return float(np.partition(values, middle)[middle])
