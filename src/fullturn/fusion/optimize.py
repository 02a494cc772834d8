"""The poses of one group that all its edges agree on best: a robust pose graph, by GTSAM."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from fullturn.errors import DependencyError, one_line

# A registration's covariance speaks of noise, not of what scans do to shapes: no edge is firmer
# than so many radians and units of the fusion.
_LEAST_SIGMA = 2e-3
_ANCHOR_SIGMA = 1e-6
# Huber's, in deviations of all six numbers together: 95 % of right links stay within.
_KERNEL = 3.55


@dataclass(frozen=True, eq=False)
class Link:
    """One chosen pose between two scans of a group, by their places in it."""

    target: int
    source: int
    T_target_source: np.ndarray  # (4, 4)
    covariance: np.ndarray  # (6, 6), rotation vector, then translation; right perturbation


def gtsam() -> Any:
    """The module gtsam.

    Raises:
        DependencyError: it is not installed.
    """
    try:
        return import_module("gtsam")
    except ImportError as error:
        raise DependencyError(
            f"expected the package gtsam, importing it gives: {one_line(error)[:200]}; "
            'install it with pip install "fullturn[fuse]"'
        ) from error


def optimize_poses(
    T_group_scan: np.ndarray, links: Sequence[Link]
) -> tuple[np.ndarray, np.ndarray]:
    """The poses (n, 4, 4) at the robust least-squares optimum, and their covariances (n, 6, 6).

    Minimizes Σ ρ(‖Log(T̂⁻¹ Tᵢ⁻¹ Tⱼ)‖) in each link's covariance, ρ Huber's, with the first scan held
    where it is. Covariances are right perturbations, relative to the first scan, whose own is zero.

    Raises:
        DependencyError: gtsam is not installed.
    """
    solver = gtsam()
    graph, start = solver.NonlinearFactorGraph(), solver.Values()
    kernel = solver.noiseModel.mEstimator.Huber.Create(_KERNEL)
    for number, T in enumerate(T_group_scan):
        start.insert(number, solver.Pose3(T))
    anchor = solver.noiseModel.Isotropic.Sigma(6, _ANCHOR_SIGMA)
    graph.add(solver.PriorFactorPose3(0, solver.Pose3(T_group_scan[0]), anchor))
    for link in links:
        covariance = link.covariance + _LEAST_SIGMA**2 * np.eye(6)
        noise = solver.noiseModel.Gaussian.Covariance(covariance)
        noise = solver.noiseModel.Robust.Create(kernel, noise)
        between = solver.Pose3(link.T_target_source)
        graph.add(solver.BetweenFactorPose3(link.target, link.source, between, noise))
    best = solver.LevenbergMarquardtOptimizer(graph, start).optimize()
    marginals = solver.Marginals(graph, best)
    count = len(T_group_scan)
    poses = np.stack([best.atPose3(number).matrix() for number in range(count)])
    covariance = np.stack([marginals.marginalCovariance(number) for number in range(count)])
    covariance[0] = 0.0
    return poses, covariance
