"""small_gicp's GICP from aligned means."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
import torch

from fullturn.geometry.cloud import Cloud
from fullturn.methods.base import Estimate, Method, Traits
from fullturn.methods.external.align import align, thinned


@dataclass(frozen=True)
class GicpConfig:
    """Lengths are normalized (1 is the cloud's radius)."""

    most_points: int = 5000  # larger clouds are thinned on a grid
    voxel: float = 0.02  # of that grid
    distance: float = 1.0  # between partners, at most
    rounds: int = 100
    neighbors: int = 20  # of a covariance


@final
class Gicp(Method):
    """Plane to plane: each residual is weighed by the covariances of both neighborhoods.

    It starts with the means on one another, as clouds arrive centered on theirs.
    """

    name = "gicp"
    summary = "generalized ICP (small_gicp); needs a rough alignment"
    reference = "Segal et al., Generalized-ICP, RSS 2009; Koide, small_gicp, JOSS 2024"
    traits = Traits(local=True)
    config: ClassVar[GicpConfig] = GicpConfig()

    def estimate(self, source: Cloud, target: Cloud, *, rng: np.random.Generator) -> Estimate:
        config = self.config
        clouds = [
            thinned(
                cloud.points.numpy(force=True), most_points=config.most_points, voxel=config.voxel
            )
            for cloud in (source, target)
        ]
        T_target_source = align(
            clouds[0],
            clouds[1],
            np.eye(4),
            kind="GICP",
            distance=config.distance,
            rounds=config.rounds,
            neighbors=config.neighbors,
        )
        return Estimate(torch.from_numpy(T_target_source)[None].to(source.points.device))
