"""What a registration returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another pose that also explains the two clouds."""

    T_target_source: np.ndarray  # (4, 4) float64
    success_probability: float  # that this pose is the true one
    overlap: tuple[float, float]  # (source share, target share) that finds a partner


@dataclass(frozen=True, eq=False)
class Symmetry:
    """Why several poses fit: rotations of the source onto itself that the overlap allows."""

    axis: np.ndarray  # (3,) unit vector in the source frame
    order: int  # n-fold; 0 means a continuous symmetry (any angle)
    description: str  # for example "2-fold rotation about (0.00, 1.00, 0.00)"


@dataclass(frozen=True, eq=False)
class Registration:
    """The pose of one cloud in the frame of another, and how far to trust it.

    All lengths are in the unit of the input. `T_target_source` maps source points into the
    target's frame: ``target ≈ points @ R.T + t``.
    """

    T_target_source: np.ndarray  # (4, 4) float64
    success_probability: float  # that the truth is within 5° and 5 % of the larger radius
    overlap: tuple[float, float]  # (source share, target share) that finds a partner
    alternatives: tuple[Alternative, ...]  # ranked, best first, without the answer itself
    symmetry: Symmetry | None  # why alternatives exist, where a symmetry is the reason
    matches: np.ndarray  # (K, 2) int64, indices into source and target
    match_weights: np.ndarray  # (K,) float64 in [0, 1]
    covariance: np.ndarray  # (6, 6) rotation vector (rad) then translation, right perturbation
    seconds: dict[str, float]  # wall-clock seconds per stage, "total" included
    method: str  # the method that produced it
    notes: tuple[str, ...] = field(default=())  # things worth telling, e.g. dropped points
