"""What is seen of a model from all around: its outside, side by side, and nothing of its inside."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from jaxtyping import Bool, Float

from fullturn.data.camera import look_at, sphere_directions
from fullturn.data.scanner import Scanner
from fullturn.geometry.neighbors import NeighborIndex
from fullturn.geometry.sampling import point_spacing, voxel_sample

DISTANCE = 3.0  # of the eyes from the middle, in radii
_FIRST_PIXELS = 64  # a side, of the look that says how many pixels it takes
_WANTED = 6000  # returns of a view
_FEWEST = 30  # a view with fewer shows next to nothing
_CLOUD_POINTS = 40_000  # of a model without faces: more say nothing about what hides what


@dataclass(frozen=True, eq=False)
class View:
    """What is seen from one direction."""

    direction: Float[np.ndarray, "3"]  # from the model's middle to the eye
    points: Float[np.ndarray, "n 3"]

    @property
    def eye(self) -> Float[np.ndarray, "3"]:
        return DISTANCE * self.direction


def views_of_mesh(mesh: trimesh.Trimesh, *, count: int) -> list[View]:
    """Views of a mesh in the unit ball, from evenly spread directions; faces have two sides."""
    scanner = Scanner(mesh)
    rng = np.random.default_rng(0)
    found = []
    for direction in sphere_directions(count):
        camera = look_at(
            DISTANCE * direction,
            np.zeros(3),
            fov_deg=math.degrees(2.0 * math.asin(1.0 / DISTANCE)),
            width=_FIRST_PIXELS,
            height=_FIRST_PIXELS,
        )
        seen = scanner.look(camera, wanted=_WANTED, enough=_FEWEST, rng=rng)
        if seen is not None:
            found.append(View(direction, seen.points))
    return found


def views_of_cloud(points: Float[np.ndarray, "n 3"], *, count: int) -> list[View]:
    """Views of a complete cloud in the unit ball: what no other point hides."""
    cloud = torch.from_numpy(points)
    if len(cloud) > _CLOUD_POINTS:
        cloud = cloud[torch.linspace(0, len(cloud) - 1, _CLOUD_POINTS).long()]
    index = NeighborIndex(cloud)
    spacing = point_spacing(cloud, index=index)
    # Evenly spread, so that dense parts have no finer pixels than the gaps of thin ones.
    even, _ = voxel_sample(cloud, max(1.5 * spacing, 0.01))
    gap = float(NeighborIndex(even).knn(even, 2)[1][:, 1].quantile(0.9))
    found = []
    for direction in sphere_directions(count):
        seen = visible(even.numpy(), DISTANCE * direction, pixel=2.0 * gap, margin=3.0 * gap)
        if seen.sum() >= _FEWEST:
            found.append(View(direction, even.numpy()[seen]))
    return found


def visible(
    points: Float[np.ndarray, "n 3"],
    eye: Float[np.ndarray, "3"],
    *,
    pixel: float,
    margin: float,
) -> Bool[np.ndarray, "n"]:
    """Which points of a cloud around the origin an eye sees: none in their pixel is much nearer.

    A pixel is `pixel` wide at the origin; "much" is more than `margin`.
    """
    distance = float(np.linalg.norm(eye))
    forward = -eye / distance
    right = np.cross(forward, np.eye(3)[np.abs(forward).argmin()])
    right /= np.linalg.norm(right)
    depth = (points - eye) @ forward
    image = (points - eye) @ np.stack([right, np.cross(forward, right)], 1) / depth[:, None]
    cell = np.floor((image - image.min(axis=0)) * (distance / pixel)).astype(np.int64)
    nearest = np.full(tuple(cell.max(axis=0) + 1), np.inf)
    np.minimum.at(nearest, (cell[:, 0], cell[:, 1]), depth)
    return depth <= nearest[cell[:, 0], cell[:, 1]] + margin
