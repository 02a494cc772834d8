"""What Open3D's global methods share: thinned clouds with normals and FPFH, then ICP on all."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import torch
from jaxtyping import Float

from fullturn.geometry.cloud import Cloud
from fullturn.methods.base import Estimate, Method
from fullturn.methods.external.optional import open3d
from fullturn.methods.external.rotation import rigid_or


@dataclass(frozen=True)
class FpfhConfig:
    """How points are described; lengths are normalized (1 is the cloud's radius)."""

    most_points: int = 4000  # larger clouds are thinned on a grid for the global step
    voxel: float = 0.04  # of that grid
    normal_neighbors: int = 30
    feature_radius: float = 0.3
    feature_neighbors: int = 100


@dataclass(frozen=True)
class IcpConfig:
    """Point-to-plane ICP on all points."""

    distance: float = 0.05  # between partners, at most
    rounds: int = 30


@dataclass(frozen=True, eq=False)
class Described:
    """One cloud as Open3D has it: in full, and thinned with a feature per point."""

    full: Any  # open3d.geometry.PointCloud with normals
    thin: Any  # the same object where the cloud is small
    features: Any = field(repr=False)  # open3d.pipelines.registration.Feature


class Open3dMethod(Method):
    """1. Thin large clouds on a grid. 2. Normals, FPFH. 3. The global pose. 4. ICP on all points.

    Open3D runs with one thread, and draws from a generator of its own that is seeded in each call:
    so the same seed gives the same bytes.
    """

    needs = ("open3d",)
    fpfh: ClassVar[FpfhConfig] = FpfhConfig()
    icp: ClassVar[IcpConfig] = IcpConfig()

    def __init__(self) -> None:
        self.open3d = open3d()

    def estimate(self, source: Cloud, target: Cloud, *, rng: np.random.Generator) -> Estimate:
        with _alone(self.open3d):
            self.open3d.utility.random.seed(int(rng.integers(2**31)))
            seen_source = self._describe(source.points.numpy(force=True))
            seen_target = self._describe(target.points.numpy(force=True))
            T_coarse = self.global_pose(seen_source, seen_target)
            T_target_source = self._refine(seen_source, seen_target, T_coarse)
        return Estimate(torch.from_numpy(T_target_source)[None].to(source.points.device))

    @abstractmethod
    def global_pose(self, source: Described, target: Described) -> Float[np.ndarray, "4 4"]:
        """The pose from the features of the thinned clouds."""

    def _describe(self, points: Float[np.ndarray, "n 3"]) -> Described:
        geometry, config = self.open3d.geometry, self.fpfh
        full = geometry.PointCloud(self.open3d.utility.Vector3dVector(points))
        self._add_normals(full)
        thin = full
        if len(points) > config.most_points:
            thin = geometry.PointCloud(full.points).voxel_down_sample(config.voxel)
            self._add_normals(thin)
        search = geometry.KDTreeSearchParamHybrid(config.feature_radius, config.feature_neighbors)
        features = self.open3d.pipelines.registration.compute_fpfh_feature(thin, search)
        return Described(full, thin, features)

    def _add_normals(self, cloud: Any) -> None:
        search = self.open3d.geometry.KDTreeSearchParamKNN(self.fpfh.normal_neighbors)
        cloud.estimate_normals(search)
        cloud.orient_normals_towards_camera_location(cloud.get_center())

    def _refine(
        self, source: Described, target: Described, T_coarse: Float[np.ndarray, "4 4"]
    ) -> Float[np.ndarray, "4 4"]:
        registration = self.open3d.pipelines.registration
        T_target_source = registration.registration_icp(
            source.full,
            target.full,
            self.icp.distance,
            T_coarse,
            registration.TransformationEstimationPointToPlane(),
            registration.ICPConvergenceCriteria(max_iteration=self.icp.rounds),
        ).transformation
        return rigid_or(np.array(T_target_source), np.array(T_coarse))


@contextmanager
def _alone(open3d: Any) -> Iterator[None]:
    """Open3D with one thread, and silent: its sums, and so its poses, depend on the threads."""
    threads = open3d.utility.get_max_threads()
    open3d.utility.set_max_threads(1)
    try:
        with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
            yield
    finally:
        open3d.utility.set_max_threads(threads)
