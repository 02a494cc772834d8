"""KISS-Matcher, then ICP."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import cKDTree

from fullturn.geometry.cloud import Cloud
from fullturn.geometry.motion import rigid
from fullturn.methods.base import Estimate, Method
from fullturn.methods.external.align import align, thinned
from fullturn.methods.external.optional import kiss_matcher
from fullturn.methods.external.rotation import rigid_or


@dataclass(frozen=True)
class KissConfig:
    """What differs from the library's defaults is explained in docs/baselines.md.

    Lengths are normalized (1 is the cloud's radius).
    """

    most_points: int = 4000  # larger clouds are thinned on a grid for the global step
    grid: float = 0.04  # of that grid
    voxel: float = 0.06  # the unit of the library's radii and bounds; it thins nothing itself
    normal_radius: float = 3.0  # in voxels
    feature_radius: float = 5.0  # in voxels
    pruning_bound: float = 1.5  # in voxels, of the lengths that the graph of matches compares
    solver_bound: float = 0.75  # in voxels, of an inlier
    icp_distance: float = 0.05
    icp_rounds: int = 30
    icp_neighbors: int = 30  # of a normal


@final
class Kiss(Method):
    """1. Thin large clouds. 2. Faster-PFH, pruning, GNC in the library. 3. ICP on all points.

    ICP is small_gicp's, point to plane, which its authors use, too.
    """

    name = "kiss"
    summary = "KISS-Matcher (Faster-PFH, pruning of matches, GNC), point-to-plane ICP"
    reference = "Lim et al., KISS-Matcher, ICRA 2025"
    needs = ("kiss_matcher",)
    config: ClassVar[KissConfig] = KissConfig()

    def __init__(self) -> None:
        self.library = kiss_matcher()

    def estimate(self, source: Cloud, target: Cloud, *, rng: np.random.Generator) -> Estimate:
        config = self.config
        full = [cloud.points.numpy(force=True) for cloud in (source, target)]
        thin = [thinned(x, most_points=config.most_points, voxel=config.grid) for x in full]
        T_coarse = self._global_pose(*thin)
        T_target_source = align(
            full[0],
            full[1],
            T_coarse,
            kind="PLANE_ICP",
            distance=config.icp_distance,
            rounds=config.icp_rounds,
            neighbors=config.icp_neighbors,
        )
        return Estimate(torch.from_numpy(T_target_source)[None].to(source.points.device))

    def _global_pose(
        self, source: Float[np.ndarray, "n 3"], target: Float[np.ndarray, "m 3"]
    ) -> Float[np.ndarray, "4 4"]:
        config = self.config
        # The process crashes in the library where no point has a normal.
        if not all(_describable(x, config.normal_radius * config.voxel) for x in (source, target)):
            return np.eye(4)
        settings = self.library.KISSMatcherConfig(
            config.voxel,
            use_voxel_sampling=False,
            normal_r_gain=config.normal_radius,
            fpfh_r_gain=config.feature_radius,
            robin_noise_bound_gain=config.pruning_bound,
            solver_noise_bound_gain=config.solver_bound,
        )
        clouds = [x.astype(np.float32) for x in (source, target)]
        with _one_cpu():
            found = self.library.KISSMatcher(settings).estimate(*clouds)
        T_target_source = rigid(np.reshape(found.rotation, (3, 3)), np.ravel(found.translation))
        return rigid_or(T_target_source, np.eye(4))


@contextmanager
def _one_cpu() -> Iterator[None]:
    """One CPU for this thread, where the system can do that.

    The library makes as many threads as it sees CPUs when it is first used, can't be told
    otherwise, and with two of them gives other last digits now and then.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    # Not the same one for all processes.
    os.sched_setaffinity(0, {sorted(before)[os.getpid() % len(before)]})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def _describable(points: Float[np.ndarray, "n 3"], radius: float) -> bool:
    """Whether ten points have four others close to them, with a margin for rounding."""
    distance, _ = cKDTree(points).query(points, k=[5])
    return int((distance < 0.95 * radius).sum()) >= 10
