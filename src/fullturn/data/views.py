"""An object scanned from all around by a virtual depth camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from fullturn.data.camera import Camera, bounding_ball, cameras_around
from fullturn.data.raycast import (
    DepthImage,
    Raycaster,
    back_project,
    mesh_ball,
    to_object,
    usable_faces,
)
from fullturn.data.sensor import Sensor, sense
from fullturn.errors import InputError

# Half a side of the support plane, in radii.
_PLANE_HALF = 1.5


@dataclass(frozen=True, eq=False)
class RangeView:
    """What one camera sees: the object's points first, then those of the plane below it."""

    points_object: Float[np.ndarray, "n 3"]  # in the object's frame
    points_camera: Float[np.ndarray, "n 3"]  # the same points in the camera's frame
    camera: Camera
    on_plane: Bool[np.ndarray, " n"]  # True: of the support plane, not of the object
    image: DepthImage  # as sensed; all pixels, whatever number of points was asked for


def view_mesh(
    mesh: trimesh.Trimesh,
    *,
    views: int = 26,
    distance: float = 3.0,
    points: int | None = None,
    thinning: Literal["random", "farthest"] = "random",
    sensor: Sensor | None = None,
    plane: bool = False,
    width: int = 160,
    height: int = 160,
    backend: Literal["auto", "embree", "python"] = "auto",
    rng: np.random.Generator,
) -> Iterator[RangeView]:
    """Range scans of a mesh from `views` directions, evenly spread and randomly turned.

    `distance`, from the eye to the middle of the mesh, is in radii of a ball around it, which the
    image just holds. Each view has at most `points` points (None: one for every pixel with a
    return), a random choice or farthest points. With `plane`, the object stands on a square, level
    in z at its lowest point, and all cameras are above its middle. A view may see nothing.

    Every view has random numbers of its own: they don't depend on what other views saw.

    Raises:
        InputError: a mesh that can't be seen (`Raycaster`), or a number out of its range.
        DependencyError: Embree was asked for and is not installed.
    """
    if views < 1 or width < 1 or height < 1 or (points is not None and points < 1):
        raise InputError(
            "expected at least 1 view, 1×1 pixels and 1 point, got "
            f"{views}, {width}×{height} and {points}; change them"
        )
    if thinning not in ("random", "farthest"):
        raise InputError(f"thinning: expected random or farthest, got {thinning!r}")
    center, radius = mesh_ball(mesh)
    scene = with_plane(mesh) if plane else mesh
    raycaster = Raycaster(scene, backend=backend)
    camera_rng, *view_rngs = rng.spawn(1 + views)
    cameras = cameras_around(
        center,
        radius,
        count=views,
        distance=distance,
        rng=camera_rng,
        width=width,
        height=height,
        above=plane,
    )

    def view(camera: Camera, own_rng: np.random.Generator) -> RangeView:
        image = raycaster.image(camera)
        if sensor is not None:
            image = sense(image, camera, scene, sensor, rng=own_rng, radius=radius)
        cloud = back_project(image.depth, camera)
        on_plane = image.face[np.isfinite(image.depth)] >= len(mesh.faces)
        keep = _thinned(cloud, points, thinning, own_rng)
        keep = keep[np.argsort(on_plane[keep], kind="stable")]
        cloud = cloud[keep]
        return RangeView(to_object(cloud, camera), cloud, camera, on_plane[keep], image)

    return (view(*each) for each in zip(cameras, view_rngs, strict=True))


def with_plane(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh on a square that is level in z at its lowest point, its two faces the last ones."""
    corners = usable_faces(mesh)[0].reshape(-1, 3)
    center, radius = bounding_ball(corners)
    half = _PLANE_HALF * radius
    square = np.array([[-half, -half], [half, -half], [half, half], [-half, half]]) + center[:2]
    square = np.column_stack([square, np.full(4, corners[:, 2].min())])
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    faces = len(vertices) + np.array([[0, 1, 2], [0, 2, 3]])
    return trimesh.Trimesh(
        np.concatenate([vertices, square]),
        np.concatenate([np.asarray(mesh.faces), faces]),
        process=False,
    )


def _thinned(
    cloud: Float[np.ndarray, "n 3"],
    points: int | None,
    thinning: Literal["random", "farthest"],
    rng: np.random.Generator,
) -> Int[np.ndarray, " k"]:
    """Which points stay, at most `points` of them, in their order."""
    if points is None or len(cloud) <= points:
        return np.arange(len(cloud))
    if thinning == "random":
        return np.sort(rng.choice(len(cloud), points, replace=False))
    # Only here, for torch takes a second to load.
    import torch

    from fullturn.geometry.sampling import farthest_point_sample

    start = int(rng.integers(len(cloud)))
    return np.sort(farthest_point_sample(torch.from_numpy(cloud), points, start=start).numpy())
