"""Open3D's RANSAC over FPFH matches, then ICP."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, ClassVar, final

import numpy as np
from jaxtyping import Float

from fullturn.methods.external.open3d_fpfh import Described, Open3dMethod


@dataclass(frozen=True)
class RansacConfig:
    """When a draw of three matches counts, and when drawing ends."""

    rounds: int = 100_000  # at most
    confidence: float = 0.999
    mutual: bool = True  # matches that are each other's nearest, where there are enough
    distance: float = 0.05  # of an inlier, in normalized lengths
    edge_ratio: float = 0.9  # of the shorter to the longer edge between two matches


class _Ransac(Open3dMethod):
    ransac: ClassVar[RansacConfig]

    @classmethod
    def settings(cls) -> dict[str, Any]:
        return {"fpfh": asdict(cls.fpfh), "ransac": asdict(cls.ransac), "icp": asdict(cls.icp)}

    def global_pose(self, source: Described, target: Described) -> Float[np.ndarray, "4 4"]:
        registration, config = self.open3d.pipelines.registration, self.ransac
        found = registration.registration_ransac_based_on_feature_matching(
            source.thin,
            target.thin,
            source.features,
            target.features,
            config.mutual,
            config.distance,
            registration.TransformationEstimationPointToPoint(False),
            3,
            [
                registration.CorrespondenceCheckerBasedOnEdgeLength(config.edge_ratio),
                registration.CorrespondenceCheckerBasedOnDistance(config.distance),
            ],
            registration.RANSACConvergenceCriteria(config.rounds, config.confidence),
        )
        return np.array(found.transformation)


@final
class Ransac(_Ransac):
    """100,000 rounds, as in Open3D's tutorial."""

    name = "ransac"
    summary = "FPFH, RANSAC with 100,000 rounds, point-to-plane ICP (Open3D)"
    reference = "Rusu et al., FPFH, ICRA 2009; Zhou et al., Open3D, 2018"
    ransac = RansacConfig()


@final
class Ransac4M(_Ransac):
    """4,000,000 rounds, as papers use it."""

    name = "ransac-4m"
    summary = "FPFH, RANSAC with 4,000,000 rounds, point-to-plane ICP (Open3D)"
    reference = "Rusu et al., FPFH, ICRA 2009; Zhou et al., Open3D, 2018"
    ransac = RansacConfig(rounds=4_000_000)
