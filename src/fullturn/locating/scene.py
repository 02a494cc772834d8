"""A scan in the model's lengths, with its planes and the parts where the model may be."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.geometry.sampling import point_spacing, voxel_sample
from fullturn.locating.model import PreparedModel
from fullturn.locating.planes import Plane, large_planes
from fullturn.locating.regions import regions

_MOST_POINTS = 60_000  # of a scene, evenly spread; a larger one is thinned further
_FLAT_PARTS = 6  # that are looked at where nothing is left but large planes


@dataclass(frozen=True, eq=False)
class SceneParts:
    """Lengths: those of the prepared model; the origin is the mean of the points."""

    points: Float[Tensor, "n 3"]  # float64, voxel means
    spacing: float
    viewpoint: Float[Tensor, "3"] | None
    planes: list[Plane]

    @cached_property
    def off_planes(self) -> Bool[Tensor, " n"]:
        """Which points lie on none of the planes."""
        off = torch.ones(len(self.points), dtype=torch.bool, device=self.points.device)
        for plane in self.planes:
            off &= ~plane.members
        return off


def take_apart(
    points: Float[Tensor, "n 3"],
    viewpoint: Float[Tensor, "3"] | None,
    model: PreparedModel,
) -> SceneParts:
    """Thin the scene to the spacing of the model's surface, and find its large planes."""
    voxel = model.fine_voxel
    thin, _ = voxel_sample(points, voxel)
    while len(thin) > _MOST_POINTS:
        voxel *= 1.5
        thin, _ = voxel_sample(points, voxel)
    spacing = max(point_spacing(thin) if len(thin) > 1 else 0.0, model.spacing)
    planes = large_planes(
        thin, diameter=model.diameter / model.radius, spacing=spacing, viewpoint=viewpoint
    )
    return SceneParts(thin, spacing, viewpoint, planes)


def free_parts(
    scene: SceneParts, free: Bool[Tensor, " n"], model: PreparedModel, *, limit: int
) -> list[Bool[Tensor, " n"]]:
    """Where the model may be, among the points that nothing explains yet."""
    find = partial(
        regions, scene.points, diameter=model.diameter / model.radius, spacing=scene.spacing
    )
    # Flat on the plane, the model may be nothing but a part of it.
    off_planes = find(free & scene.off_planes, limit=limit)
    return off_planes or find(free, limit=min(limit, _FLAT_PARTS))
