"""What `locate` returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True, eq=False)
class OtherPose:
    """Another pose that also explains what is seen."""

    T_scene_model: np.ndarray  # (4, 4) float64
    success_probability: float  # that the true pose is within 5° and 5 % of the radius of it
    surface_probability: float  # that the surface lies there


@dataclass(frozen=True, eq=False)
class Location:
    """One place of the model in the scene. `T_scene_model` maps model points into the scene."""

    T_scene_model: np.ndarray  # (4, 4) float64, in the unit of the input
    # That the true pose is within 5° and 5 % of the radius of this one: about one half where a turn
    # of the model by 180° maps it onto itself. Those of a location and its alternatives sum to at
    # most 1.
    success_probability: float
    # That the model's surface lies where this pose puts it, everywhere within 5 % of the diameter:
    # a turn of a symmetric model onto itself counts as right.
    surface_probability: float
    visible_share: float  # of the model's outside that is seen in the scene and lies on it
    # Of the part of the scene that the model was found in, thinned to one point a voxel, as the
    # model was: those within two point spacings of the model's surface.
    points: int
    alternatives: tuple[OtherPose, ...]  # ranked, without the pose itself


@dataclass(frozen=True, eq=False)
class Located:
    """Where a model stands in a scene: one location an instance, the most probable first."""

    locations: tuple[Location, ...]  # at least one, however improbable it is
    seconds: dict[str, float]  # wall-clock seconds per stage, "total" included
    notes: tuple[str, ...] = ()

    @property
    def T_scene_model(self) -> np.ndarray:
        """The most probable pose."""
        return self.locations[0].T_scene_model

    @property
    def success_probability(self) -> float:
        """Of the most probable pose."""
        return self.locations[0].success_probability

    @property
    def surface_probability(self) -> float:
        """Of the most probable pose."""
        return self.locations[0].surface_probability
