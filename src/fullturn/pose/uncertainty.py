"""How firmly the residuals hold a pose."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fullturn.geometry.cloud import Cloud
from fullturn.pose.closest_pairs import ClosestPairs

# Both directions count the same surface, and neighboring residuals share points and normals:
# squared errors are this many times what independent ones would give, where the two clouds hold the
# same points and where they don't (measured: benchmarks/covariance.py).
_INFLATION_SAME, _INFLATION_INDEPENDENT = 4.0, 7.0
# Where the clouds say nothing, a standard deviation of one radian and one radius.
_PRIOR = 1.0
# Coordinates are no better than this (normalized), even where all partners agree exactly; an
# information beyond it would swallow the prior in rounding.
_LEAST_SIGMA = 1e-6


def pose_covariance(
    T_target_source: Float[np.ndarray, "4 4"], source: Cloud, target: Cloud, *, cutoff: float
) -> Float[np.ndarray, "6 6"]:
    """Covariance of ξ in T_true = T Exp(ξ): rotation vector (rad), then translation (normalized).

    The inverse of the Gauss–Newton matrix of the final residuals, weighted by the variances that
    they show across and along the surface (`ClosestPairs`). It describes noise around this
    pose, given that it is the right one; the choice between poses is `success_probability`.
    """
    residuals = ClosestPairs(source, target).residuals(T_target_source, cutoff=cutoff)
    floor = min(1.0, residuals.sigma_normal / _LEAST_SIGMA) ** 2
    trust = residuals.trust
    inflation = trust * _INFLATION_SAME + (1.0 - trust) * _INFLATION_INDEPENDENT
    H = floor * (residuals.H + residuals.H.T) / (2.0 * inflation)
    values, vectors = np.linalg.eigh(H)
    covariance = (vectors / (np.maximum(values, 0.0) + _PRIOR)) @ vectors.T
    return (covariance + covariance.T) / 2.0
