"""A method that keeps what it was told beside the clouds."""

from __future__ import annotations

import numpy as np
import torch

from fullturn.geometry.cloud import Cloud
from fullturn.methods.base import Estimate, Method, Traits


class Told(Method):
    name, summary, reference = "told", "keeps what it was told", "these tests"
    traits = Traits(limits_rotation=True)

    def estimate(
        self,
        source: Cloud,
        target: Cloud,
        *,
        rng: np.random.Generator,
        max_rotation_rad: float | None = None,
    ) -> Estimate:
        self.max_rotation_rad = max_rotation_rad
        return Estimate(torch.eye(4, dtype=torch.float64)[None])
