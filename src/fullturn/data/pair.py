"""Two clouds and the true pose between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Pair:
    """A registration problem with its answer: ``target frame ≈ T_target_source · source``."""

    source: Float[np.ndarray, "n 3"]  # float64
    target: Float[np.ndarray, "m 3"]  # float64
    T_target_source: Float[np.ndarray, "4 4"]  # float64, the truth
    name: str  # of the shape or the scans that it shows; several pairs may share one
    source_viewpoint: Float[np.ndarray, "3"] | None = None  # sensor position, source frame
    target_viewpoint: Float[np.ndarray, "3"] | None = None  # sensor position, target frame
    related: bool = (
        True  # False: two different objects, no pose is right, the truth is the identity
    )
    # The largest rotation that is possible, as far as it is known to whoever registers the pair.
    max_rotation_deg: float | None = None
