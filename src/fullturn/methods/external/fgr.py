"""Open3D's Fast Global Registration on FPFH matches, then ICP."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, ClassVar, final

import numpy as np
from jaxtyping import Float

from fullturn.methods.external.open3d_fpfh import Described, Open3dMethod


@dataclass(frozen=True)
class FgrConfig:
    """Open3D's defaults but for the scale, which counts lengths as they are."""

    distance: float = 0.05  # scale at which the graduated optimization ends, normalized lengths
    tuples: int = 1000  # of matches whose edges agree, at most


@final
class Fgr(Open3dMethod):
    """One graduated optimization over all matches instead of draws."""

    name = "fgr"
    summary = "FPFH, Fast Global Registration, point-to-plane ICP (Open3D)"
    reference = "Zhou, Park & Koltun, Fast Global Registration, ECCV 2016"
    fgr: ClassVar[FgrConfig] = FgrConfig()

    @classmethod
    def settings(cls) -> dict[str, Any]:
        return {"fpfh": asdict(cls.fpfh), "fgr": asdict(cls.fgr), "icp": asdict(cls.icp)}

    def global_pose(self, source: Described, target: Described) -> Float[np.ndarray, "4 4"]:
        registration = self.open3d.pipelines.registration
        found = registration.registration_fgr_based_on_feature_matching(
            source.thin,
            target.thin,
            source.features,
            target.features,
            registration.FastGlobalRegistrationOption(
                use_absolute_scale=True,
                maximum_correspondence_distance=self.fgr.distance,
                maximum_tuple_count=self.fgr.tuples,
            ),
        )
        return np.array(found.transformation)
