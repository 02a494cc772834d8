"""What is seen of a model from all around: its outside, side by side, and nothing of its inside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.data.camera import ball_camera
from fullturn.data.scanner import Scanner
from fullturn.geometry.directions import sphere_directions
from fullturn.geometry.neighbors import NeighborIndex
from fullturn.geometry.sampling import point_spacing, voxel_sample
from fullturn.pose.depth import nearest_depth, pixel_of, project, sideways

DISTANCE = 3.0  # of the eyes from the middle, in radii
_FIRST_PIXELS = (64, 256)  # a side, of looks that say how many it takes; rods fall between few
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
        for pixels in _FIRST_PIXELS:
            camera = ball_camera(
                np.zeros(3), 1.0, direction, distance=DISTANCE, width=pixels, height=pixels
            )
            seen = scanner.look(camera, wanted=_WANTED, enough=_FEWEST, rng=rng)
            if seen is not None:
                found.append(View(direction, seen.points))
                break
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
        eye = torch.from_numpy(DISTANCE * direction)
        seen = even[visible(even, eye, pixel=2.0 * gap, margin=3.0 * gap)]
        if len(seen) >= _FEWEST:
            found.append(View(direction, seen.numpy()))
    return found


def visible(
    points: Float[Tensor, "n 3"], eye: Float[Tensor, "3"], *, pixel: float, margin: float
) -> Bool[Tensor, " n"]:
    """Which points of a cloud around the origin an eye sees: none in their pixel is much nearer.

    A pixel is `pixel` wide at the origin; "much" is more than `margin`.
    """
    distance = float(eye.norm())
    forward = -eye / distance
    right = sideways(forward)
    frame = torch.stack([right, torch.linalg.cross(forward, right), forward], 1)
    image, depth = project(points, eye, frame)
    half, width = float(image.abs().amax()), pixel / distance
    every, side = torch.ones_like(depth).bool(), int(2 * half / width) + 1
    cell = pixel_of(image, every, half=half, width=width, side=side)
    nearest = nearest_depth(cell[None], depth[None], every[None], side=side).flatten()
    return depth <= nearest[cell] + margin
