"""Virtual scans of known objects, alone or on a support plane, in a random frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh

from fullturn.data.camera import look_at
from fullturn.data.motion import uniform_direction, uniform_rotation
from fullturn.data.random_sensor import random_sensor
from fullturn.data.raycast import Raycaster, back_project, mesh_ball, to_object
from fullturn.data.sensor import sense
from fullturn.geometry.motion import invert, move, rigid

_FIRST_PIXELS = 64  # a side
_MOST_PIXELS = 360


@dataclass(frozen=True, eq=False)
class Scene:
    """A scan, and where in it the model stands."""

    points: np.ndarray  # (n, 3)
    viewpoint: np.ndarray  # (3,)
    T_scene_model: np.ndarray  # (4, 4)
    object_points: int  # returns from the object, before those that a sensor loses


def scene_of(
    mesh: trimesh.Trimesh,
    rng: np.random.Generator,
    *,
    plane: bool,
    others: Sequence[trimesh.Trimesh] = (),
) -> Scene | None:
    """A scan of a mesh with sensor noise; None where it shows too little of it.

    With `plane`, the object rests with a side of its convex hull on a square of three diameters and
    is seen from 20° to 75° above it; what is farther than 1.3 diameters from its middle is cut off.
    `others` lie beside it on the plane. Without, it is seen from anywhere.
    """
    center, radius = mesh_ball(mesh)
    returns = int(np.exp(rng.uniform(np.log(600), np.log(5000))))
    whole = mesh
    toward = uniform_direction(rng)
    if plane:
        up = _resting(mesh, rng)
        whole = _on_square(mesh, up, 3.0 * 2.0 * radius)
        for other in others:
            whole = trimesh.util.concatenate([whole, _beside(mesh, other, up, rng)])
        toward = _from_above(up, rng)
    distance = rng.uniform(2.0, 4.0)
    eye = center + distance * radius * toward
    wide = 2.6 if plane else 1.0
    fov_deg = np.degrees(2.0 * np.arctan(wide / np.sqrt(distance**2 - 1.0)))
    camera = look_at(eye, center, fov_deg=fov_deg, width=_FIRST_PIXELS, height=_FIRST_PIXELS)
    caster = Raycaster(whole)
    hits = _object_hits(caster.image(camera).face, mesh)
    if hits < 20:
        return None
    side = min(round(_FIRST_PIXELS * np.sqrt(returns / hits)), _MOST_PIXELS)
    camera = replace(camera, focal=camera.focal * side / camera.width, width=side, height=side)
    image = caster.image(camera)
    hits = _object_hits(image.face, mesh)
    sensor = random_sensor(rng, distance=distance)
    seen = sense(image, camera, whole, sensor, rng=rng, radius=radius)
    points = to_object(back_project(seen.depth, camera), camera)
    points = points[np.linalg.norm(points - center, axis=1) < 1.3 * 2.0 * radius]
    if hits < 150 or len(points) < 150:
        return None
    T_scene_model = rigid(uniform_rotation(rng), rng.normal(size=3) * 5.0 * radius)
    points = move(T_scene_model, points)[rng.permutation(len(points))]
    return Scene(points, move(T_scene_model, eye[None])[0], T_scene_model, hits)


def _object_hits(face: np.ndarray, mesh: trimesh.Trimesh) -> int:
    return int(((face >= 0) & (face < len(mesh.faces))).sum())


def _resting(mesh: trimesh.Trimesh, rng: np.random.Generator) -> np.ndarray:
    """The direction that is up when the mesh lies on a side of its hull, large ones likelier."""
    hull = trimesh.convex.convex_hull(mesh)
    return -hull.face_normals[rng.choice(len(hull.faces), p=hull.area_faces / hull.area)]


def _on_square(mesh: trimesh.Trimesh, up: np.ndarray, side: float) -> trimesh.Trimesh:
    across = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    across /= np.linalg.norm(across)
    along = np.cross(up, across)
    middle = mesh.vertices.mean(axis=0)
    middle = middle + (np.min(mesh.vertices @ up) - middle @ up) * up
    corners = [middle + side / 2 * (a * across + b * along) for a, b in _CORNERS]
    faces = np.array([[0, 1, 2], [0, 2, 3]]) + len(mesh.vertices)
    return trimesh.Trimesh(
        np.vstack([mesh.vertices, corners]), np.vstack([mesh.faces, faces]), process=False
    )


def _beside(
    mesh: trimesh.Trimesh, other: trimesh.Trimesh, up: np.ndarray, rng: np.random.Generator
) -> trimesh.Trimesh:
    """Another object on the same plane, at a random place close by."""
    center, radius = mesh_ball(mesh)
    its_center, its_radius = mesh_ball(other)
    scale = rng.uniform(0.4, 1.2) * radius / its_radius
    turned = scale * (other.vertices - its_center) @ uniform_rotation(rng).T
    side = np.cross(up, uniform_direction(rng))
    side /= np.linalg.norm(side)
    reach = np.max((mesh.vertices - center) @ side) + np.max(-turned @ side)
    place = center + (reach + rng.uniform(0.02, 0.6) * radius) * side
    place = place + (np.min(mesh.vertices @ up) - np.min(turned @ up) - place @ up) * up
    return trimesh.Trimesh(turned + place, other.faces, process=False)


_CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def _from_above(up: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    height = rng.uniform(np.sin(np.radians(20.0)), np.sin(np.radians(75.0)))
    side = np.cross(up, uniform_direction(rng))
    side /= np.linalg.norm(side)
    return height * up + np.sqrt(1.0 - height**2) * side


def model_in_own_unit(mesh: trimesh.Trimesh, rng: np.random.Generator) -> trimesh.Trimesh:
    """The mesh in a unit and a frame of its own: from millimeters to kilometers."""
    scale = 10.0 ** rng.uniform(-2, 3)
    T = invert(rigid(uniform_rotation(rng), rng.normal(size=3)))
    return trimesh.Trimesh(scale * move(T, mesh.vertices), mesh.faces, process=False)
