"""The last refinement, at full resolution, weighted by the noise that it measures."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.geometry.cloud import Cloud
from fullturn.pose.kabsch import nearest_motion
from fullturn.pose.residuals import gauss_newton_step, normal_equations

# The share of mutual nearest neighbors at which points aren't trusted to be the same ones, and that
# at which they fully are: two samplings of a surface lie below, one and the same above.
_MUTUAL_INDEPENDENT, _MUTUAL_SAME = 0.54, 0.66
_LEAST_POINT_SHARE = 0.01
# Rounds begin with about so many points of each cloud, as long as steps are longer than this share
# of the noise; the pose has settled when they are shorter than the second.
_FIRST_POINTS, _FIRST_ROUNDS = 300, 20
_ROUNDS = 30  # most settle in ten; along smooth surfaces, steps stay short
_NEAR, _SETTLED = 0.1, 0.02


@dataclass(frozen=True, eq=False)
class Residuals:
    """The weighted least-squares problem at one pose, in the source frame (right perturbation)."""

    H: Float[Tensor, "6 6"]  # in units of 1/σ²: an information matrix, both directions counted
    g: Float[Tensor, "6"]
    sigma_normal: float  # off the surface, robust
    sigma_tangent: float  # along the surface, per axis, robust
    trust: float  # that a partner is the same physical point, 0 to 1
    point_share: float  # of the weight along the surface in that across it
    reach: float  # three deviations: how far apart partners may lie


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
    T = T_target_source
    cutoff = start
    few = max(1, min(len(source.sample), len(target.sample)) // _FIRST_POINTS)
    for every, rounds, enough in ((few, _FIRST_ROUNDS, _NEAR), (1, _ROUNDS, _SETTLED)):
        for _ in range(rounds):
            residuals = measure_residuals(T, source, target, cutoff=cutoff, every=every)
            step = gauss_newton_step(residuals.H, residuals.g, damping=1e-6, largest=0.2)
            T = T @ rigid.small_motion(step)
            moved = float(step.abs().max())
            settled = moved < enough * residuals.sigma_normal and residuals.reach > 0.9 * cutoff
            cutoff = min(cutoff, max(residuals.reach, 4.0 * moved))
            if settled:
                break
    return nearest_motion(T)


def measure_residuals(
    T_target_source: Float[Tensor, "4 4"],
    source: Cloud,
    target: Cloud,
    *,
    cutoff: float,
    every: int = 1,
) -> Residuals:
    """Pair the samples' points up with all of the other cloud's, and weigh them by their noise.

    Of the samples, one in `every` points is taken.
    """
    T_source_target = rigid.invert(T_target_source)
    own, others = source.sample[::every], target.sample[::every]
    moved = rigid.apply(T_target_source, own)
    partner, distance = target.index.nearest(moved, within=cutoff)
    y = rigid.apply(T_source_target, target.points[partner])
    forward = distance < cutoff
    mutual = torch.zeros_like(forward)
    if forward.any():
        back, _ = source.index.nearest(y[forward])
        mutual[forward] = (source.points[back] == own[forward]).all(-1)
    pulled = rigid.apply(T_source_target, others)
    partner, distance = source.index.nearest(pulled, within=cutoff)
    x = source.points[partner]
    backward = distance < cutoff
    at = torch.cat([own[forward], x[backward]])
    if len(at) < 6:
        zero = at.new_zeros(6)
        return Residuals(torch.diag(zero), zero, cutoff, cutoff, 0.0, 1.0, cutoff)
    difference = torch.cat([own[forward] - y[forward], x[backward] - pulled[backward]])
    target_normals = target.sample_normals[::every] @ T_target_source[:3, :3]
    normal = torch.cat([source.sample_normals[::every][forward], target_normals[backward]])

    height = (difference * normal).sum(-1)
    along = (difference - height[:, None] * normal).norm(dim=-1)
    tiny = 1e-12
    # Medians: of |N(0, σ²)| it is 0.6745 σ, of a length in two dimensions 1.1774 σ.
    sigma_normal = float(height.abs().median()) / 0.6745 + tiny
    sigma_tangent = float(along.median()) / 1.1774 + tiny
    share = float(mutual[forward].double().mean()) if forward.any() else 0.0
    trust = (share - _MUTUAL_INDEPENDENT) / (_MUTUAL_SAME - _MUTUAL_INDEPENDENT)
    trust = min(1.0, max(0.0, trust))
    ratio = min(1.0, (sigma_normal / sigma_tangent) ** 2)
    point_share = max(_LEAST_POINT_SHARE, trust) * ratio
    reach = min(cutoff, 3.0 * (sigma_normal**2 + 2.0 * sigma_tangent**2) ** 0.5)
    # Tukey on the two variances; a pair three deviations off across the surface counts nothing.
    unlikely = (height / (4.0 * sigma_normal)).square() + (along / reach).square()
    weight = (1.0 - unlikely).clamp_min(0).square() / sigma_normal**2
    H, g = normal_equations(at, difference, normal, weight, point_share=point_share)
    return Residuals(H, g, sigma_normal, sigma_tangent, trust, point_share, reach)
