"""One part of a scene, ready to be compared with the model."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Bool, Float, Int
from torch import Tensor

from fullturn.geometry.neighbors import NeighborIndex
from fullturn.geometry.normals import estimate_normals
from fullturn.geometry.sampling import local_area
from fullturn.locating.scene import SceneParts
from fullturn.locating.sight import Sight
from fullturn.pose.grid import NearestGrid

# How far beyond the box of a part its grid reaches, and from its middle at most.
_AROUND, _REACH = 0.5, 2.6
_SMOOTHED = 12  # neighbors over which noise is averaged


@dataclass(frozen=True, eq=False)
class Part:
    """Points of a scene around their own middle, what lies around them, and what was seen."""

    points: Float[Tensor, "n 3"]  # float32, less the middle
    normals: Float[Tensor, "n 3"]
    area: Float[Tensor, " n"]
    neighbor: Int[Tensor, "n j"]  # the nearest points of the part, each point itself among them
    middle: Float[Tensor, "3"]  # float64
    grid: NearestGrid  # of this part and all around it
    viewpoint: Float[Tensor, "3"] | None
    sight: Sight | None  # where the viewpoint is known
    spacing: float


def take_part(scene: SceneParts, members: Bool[Tensor, " n"]) -> Part:
    """The members with their normals, and a grid of all scene points near them."""
    middle = scene.points[members].mean(0)
    points = (scene.points - middle)[members]
    low, high = points.amin(0) - _AROUND, points.amax(0) + _AROUND
    around = ((scene.points - middle >= low) & (scene.points - middle <= high)).all(1)
    every = (scene.points - middle)[around]
    normals = estimate_normals(every, k=min(20, len(every)), orientation="none").float()
    grid = NearestGrid(
        every.float(),
        normals,
        cell=0.75 * scene.spacing,
        band=4.0 * scene.spacing,
        reach=_REACH,
    )
    viewpoint, sight = None, None
    if scene.viewpoint is not None:
        viewpoint = (scene.viewpoint - middle).float()
        all_points = (scene.points - middle).float()
        h = scene.spacing
        sight = Sight(all_points, viewpoint, pixel=2.0 * h, margin=2.0 * h)
    return Part(
        points.float(),
        normals[members[around]],
        local_area(points).float(),
        NeighborIndex(points).knn(points, min(_SMOOTHED, len(points)))[0],
        middle,
        grid,
        viewpoint,
        sight,
        scene.spacing,
    )
