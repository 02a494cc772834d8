"""Small scenes for the tests: a dog, alone, on a plane, twice."""

from __future__ import annotations

import numpy as np
import trimesh

from fullturn.data.camera import look_at
from fullturn.data.motion import uniform_rotation
from fullturn.data.procedural import dog
from fullturn.data.raycast import Raycaster, back_project, to_object
from fullturn.geometry.motion import move, rigid


def model() -> trimesh.Trimesh:
    return dog()


def square(half: float, height: float) -> trimesh.Trimesh:
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    corners = np.column_stack([corners, np.full(4, height)])
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def uneven_ground(half: float, height: float) -> trimesh.Trimesh:
    """No plane of it is large; up to `height`, and 0.3 below."""
    side = np.linspace(-half, half, 25)
    x, y = (values.ravel() for values in np.meshgrid(side, side, indexing="ij"))
    z = height - 0.15 + 0.15 * np.sin(2.3 * x + 0.4) * np.cos(1.9 * y)
    corner = np.arange(625).reshape(25, 25)
    a, b, c, d = (
        corner[rows, columns].ravel()
        for rows in (slice(-1), slice(1, None))
        for columns in (slice(-1), slice(1, None))
    )
    faces = np.vstack([np.column_stack([a, b, d]), np.column_stack([a, d, c])])
    return trimesh.Trimesh(np.column_stack([x, y, z]), faces, process=False)


def scan(
    meshes: list[trimesh.Trimesh],
    eye: tuple[float, float, float],
    rng: np.random.Generator,
    *,
    pixels: int = 90,
    noise: float = 0.003,
    reach: float = 3.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, the sensor's place and T_scene_world of one look, in a random frame."""
    place = np.array(eye)
    camera = look_at(place, np.zeros(3), fov_deg=55.0, width=pixels, height=pixels)
    depth = Raycaster(trimesh.util.concatenate(meshes), backend="python").image(camera).depth
    depth = depth + noise * rng.standard_normal(depth.shape)
    points = to_object(back_project(depth, camera), camera)
    points = points[np.linalg.norm(points, axis=1) < reach]
    T_scene_world = rigid(uniform_rotation(rng), rng.normal(size=3))
    return move(T_scene_world, points), move(T_scene_world, place[None])[0], T_scene_world


def moved(mesh: trimesh.Trimesh, T: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(move(T, mesh.vertices), mesh.faces, process=False)
