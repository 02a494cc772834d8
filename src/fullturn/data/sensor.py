"""What a real sensor makes of an exact depth image: noise, steps, lost and mixed returns."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import trimesh
from jaxtyping import Bool, Float

from fullturn.data.camera import Camera
from fullturn.data.raycast import DepthImage, mesh_ball
from fullturn.errors import InputError

# Neighboring pixels this many radii apart in depth lie on two surfaces.
_JUMP = 0.05


@dataclass(frozen=True)
class Sensor:
    """What a sensor does to depth; by default nothing. Lengths are in radii of the object.

    Errors in depth grow with its square, as disparity is what a stereo or structured-light sensor
    measures (Khoshelham and Elberink, "Accuracy and resolution of Kinect depth data", 2012).

    Raises:
        InputError: a value out of its range; all of them are named.
    """

    # Standard deviation of the depth at a distance of one radius; grows with depth².
    noise: float = 0.0
    # Depth comes in steps, as large as this at a distance of one radius.
    quantize: float = 0.0
    # "disparity": steps that grow with depth², as 1/depth is what is rounded; "depth": even ones.
    quantize_what: Literal["disparity", "depth"] = "disparity"
    # Returns get lost where the line of sight meets the surface at less than this angle: the share
    # that stays is sin(angle) / sin(limit), as less and less light comes back.
    grazing_deg: float = 0.0
    # Share of the pixels at a depth edge that mix both surfaces and land anywhere between them.
    flying: float = 0.0
    # Number of irregular patches without a return, and their mean radius.
    holes: int = 0
    hole_radius: float = 0.1

    def __post_init__(self) -> None:
        wrong = [
            f"{name} {wanted}, got {value}"
            for name, value, least, most, wanted in (
                ("noise", self.noise, 0.0, math.inf, "of 0 or more"),
                ("quantize", self.quantize, 0.0, math.inf, "of 0 or more"),
                ("grazing_deg", self.grazing_deg, 0.0, 90.0, "from 0 to 90"),
                ("flying", self.flying, 0.0, 1.0, "from 0 to 1"),
                ("holes", self.holes, 0, math.inf, "of 0 or more"),
                ("hole_radius", self.hole_radius, 0.0, math.inf, "of 0 or more"),
            )
            if not (least <= value <= most and math.isfinite(value))
        ]
        if self.quantize_what not in ("disparity", "depth"):
            wrong.append(f'quantize_what of "disparity" or "depth", got {self.quantize_what!r}')
        if wrong:
            raise InputError(f"sensor: expected {'; '.join(wrong)}")


def sense(
    image: DepthImage,
    camera: Camera,
    mesh: trimesh.Trimesh,
    sensor: Sensor,
    *,
    rng: np.random.Generator,
    radius: float | None = None,
) -> DepthImage:
    """The depth image that `sensor` gives, where an ideal one gives `image` of `mesh`.

    `radius` is the length that the sensor's lengths are counted in, by default that of a ball
    around the mesh. Each effect has its own random numbers, so that switching one on leaves the
    others as they were. A pixel keeps the face that it saw, unless its return is lost.
    """
    if radius is None:
        radius = mesh_ball(mesh)[1]
    streams = rng.spawn(4)
    exact, depth = image.depth, image.depth
    if sensor.flying > 0.0:
        depth = _mixed(exact, sensor.flying, _JUMP * radius, streams[0])
    if sensor.grazing_deg > 0.0:
        lost = _grazing(image, camera, mesh, sensor.grazing_deg, streams[1])
        depth = np.where(lost, np.inf, depth)
    if sensor.holes > 0:
        lost = _in_holes(exact, camera, sensor.holes, sensor.hole_radius * radius, streams[2])
        depth = np.where(lost, np.inf, depth)
    if sensor.noise > 0.0:
        seen = np.isfinite(depth)
        sigma = sensor.noise * np.where(seen, depth, 0.0) ** 2 / radius
        depth = depth + sigma * streams[3].standard_normal(depth.shape)
    if sensor.quantize > 0.0:
        depth = _in_steps(depth / radius, sensor.quantize, sensor.quantize_what) * radius
    depth = np.where(depth > 0.0, depth, np.inf)
    return replace(image, depth=depth, face=np.where(np.isfinite(depth), image.face, -1))


def _mixed(
    depth: Float[np.ndarray, "h w"], share: float, jump: float, rng: np.random.Generator
) -> Float[np.ndarray, "h w"]:
    """Some pixels at depth edges moved towards the neighbor that is farthest off in depth.

    An edge against nothing stays: there is no second surface to mix with.
    """
    height, width = depth.shape
    around = np.full((height + 2, width + 2), np.inf)
    around[1:-1, 1:-1] = depth
    neighbors = np.stack([around[:-2, 1:-1], around[2:, 1:-1], around[1:-1, :-2], around[1:-1, 2:]])
    both = np.isfinite(depth) & np.isfinite(neighbors)
    apart = np.where(both, np.where(both, neighbors, 0.0) - np.where(both, depth, 0.0), 0.0)
    farthest = np.abs(apart).argmax(axis=0)
    step = np.take_along_axis(apart, farthest[None], axis=0)[0]
    drawn, part = rng.random((2, height, width))
    moves = (np.abs(step) > jump) & (drawn < share)
    return np.where(moves, depth + part * step, depth)


def _grazing(
    image: DepthImage,
    camera: Camera,
    mesh: trimesh.Trimesh,
    limit_deg: float,
    rng: np.random.Generator,
) -> Bool[np.ndarray, "h w"]:
    """Pixels whose return is lost: all at 0° between sight and surface, none from the limit on."""
    drawn = rng.random(image.depth.shape)
    hit = image.face >= 0
    corners = np.asarray(mesh.vertices, dtype=np.float64)[mesh.faces[image.face[hit]]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sight = camera.rays()[hit] @ camera.T_camera_object[:3, :3]
    lengths = np.linalg.norm(normal, axis=1) * np.linalg.norm(sight, axis=1)
    lost = np.zeros(hit.shape, dtype=bool)
    limit = math.sin(math.radians(limit_deg))
    lost[hit] = np.abs((normal * sight).sum(axis=1)) < drawn[hit] * limit * lengths
    return lost


def _in_holes(
    depth: Float[np.ndarray, "h w"],
    camera: Camera,
    count: int,
    radius: float,
    rng: np.random.Generator,
) -> Bool[np.ndarray, "h w"]:
    """Pixels in patches around random pixels that see something; their outlines are wavy."""
    lost = np.zeros(depth.shape, dtype=bool)
    seen = np.argwhere(np.isfinite(depth))
    if len(seen) == 0:
        return lost
    rows, columns = np.indices(depth.shape)
    for row, column in seen[rng.integers(len(seen), size=count)]:
        down, right = rows - row, columns - column
        angle_rad = np.arctan2(down, right)
        phase_rad = rng.uniform(0.0, 2.0 * math.pi, 2)
        outline = 1.0 + 0.3 * np.sin(2.0 * angle_rad + phase_rad[0])
        outline += 0.2 * np.sin(3.0 * angle_rad + phase_rad[1])
        lost |= np.hypot(down, right) <= outline * radius * camera.focal / depth[row, column]
    return lost


def _in_steps(
    depth: Float[np.ndarray, "h w"], step: float, what: Literal["disparity", "depth"]
) -> Float[np.ndarray, "h w"]:
    """Depth, in radii, rounded to steps; a disparity that is rounded to 0 is lost."""
    if what == "depth":
        return np.where(np.isfinite(depth), np.round(depth / step) * step, depth)
    with np.errstate(divide="ignore"):
        return 1.0 / (np.round(1.0 / np.where(depth > 0.0, depth, np.inf) / step) * step)
