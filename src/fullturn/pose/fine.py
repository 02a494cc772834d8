"""The last refinement, at full resolution, weighted by the noise that it measures."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry.cloud import Cloud
from fullturn.geometry.motion import small_motion
from fullturn.pose.closest_pairs import ClosestPairs
from fullturn.pose.kabsch import nearest_motion
from fullturn.pose.residuals import gauss_newton_step

# Rounds begin with about so many points of each cloud, as long as steps are longer than this share
# of the noise; the pose has settled when they are shorter than the second.
_FIRST_POINTS, _FIRST_ROUNDS = 300, 20
_ROUNDS = 30  # most settle in ten; along smooth surfaces, steps stay short
_NEAR, _SETTLED = 0.1, 0.02
_DAMPING = 1e-6  # just enough to be solvable
_LARGEST_STEP = 0.2


def refine_fine(
    T_target_source: Float[Tensor, "4 4"],
    source: Cloud,
    target: Cloud,
    *,
    start: float,
) -> Float[Tensor, "4 4"]:
    """The pose at the optimum next to the given one; `start` is the first search distance.

    Iterative closest point in both directions. The residual of each pair is weighted by the
    variances across and along the surface, measured anew in each round, so the result needs no
    noise level: where the two clouds share one sampling, points pull like points; where they
    don't, they pull like planes.
    """
    T = T_target_source.numpy(force=True)
    cutoff = start
    few = max(1, min(len(source.sample), len(target.sample)) // _FIRST_POINTS)
    for every, rounds, enough in ((few, _FIRST_ROUNDS, _NEAR), (1, _ROUNDS, _SETTLED)):
        pairs = ClosestPairs(source, target, every=every)
        for _ in range(rounds):
            residuals = pairs.residuals(T, cutoff=cutoff)
            step = gauss_newton_step(
                residuals.H, residuals.g, damping=_DAMPING, largest=_LARGEST_STEP
            )
            T = T @ small_motion(step)
            moved = float(np.abs(step).max())
            settled = moved < enough * residuals.sigma_normal and residuals.reach > 0.9 * cutoff
            cutoff = min(cutoff, max(residuals.reach, 4.0 * moved))
            if settled:
                break
    return nearest_motion(torch.from_numpy(T).to(T_target_source))
