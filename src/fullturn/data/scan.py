"""A virtual depth camera: what one view of an object sees, and pairs of such views."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from fullturn.data.motion import (
    ball_translation,
    invert,
    move,
    rigid,
    uniform_direction,
    uniform_rotation,
)
from fullturn.data.pair import Pair
from fullturn.data.surface import sample_faces
from fullturn.errors import InputError

# Samples per wanted point: with fewer, hidden surfaces shine through pixels without a sample.
_DENSITY = 72
_LEAST_DENSE = 100_000
_SPARE = 1.15  # more pixels than points are asked for, so that a random choice is left


def scan(
    surface: trimesh.Trimesh | Float[np.ndarray, "dense 3"],
    camera: Float[np.ndarray, "3"],
    *,
    count: int = 2048,
    rng: np.random.Generator,
    noise_sigma: float = 0.0,
    grazing_deg: float = 0.0,
) -> Float[np.ndarray, "n 3"]:
    """The points of a surface that a camera sees, one a pixel, in the frame of the surface.

    A dense sample is projected (pinhole, looking at its mean) onto a grid whose pixels are sized
    for about `count` hits; the nearest sample of each pixel is kept. At most `count` points come
    back, fewer where many returns are lost at grazing angles.

    `noise_sigma` is the standard deviation along the line of sight, in the surface's unit. Below
    `grazing_deg` between line of sight and surface, returns get lost: all at 0°, none at the limit;
    that needs a mesh, whose normals are known.
    """
    camera = np.asarray(camera, dtype=np.float64)
    if isinstance(surface, trimesh.Trimesh):
        dense, face = sample_faces(surface, max(_DENSITY * count, _LEAST_DENSE), rng)
    elif grazing_deg > 0.0:
        raise InputError(
            "expected a mesh for grazing_deg > 0, got bare points; pass a mesh or grazing_deg=0"
        )
    else:
        dense = np.asarray(surface, dtype=np.float64)
    image, depth = _project(dense, camera)
    seen = np.flatnonzero(_nearest_per_pixel(image, depth, round(_SPARE * count)))
    if isinstance(surface, trimesh.Trimesh) and grazing_deg > 0.0:
        normals = np.asarray(surface.face_normals)[face[seen]]
        sight = dense[seen] - camera
        sine = np.abs((normals * sight).sum(axis=1)) / np.linalg.norm(sight, axis=1)
        seen = seen[sine >= rng.random(len(seen)) * np.sin(np.deg2rad(grazing_deg))]
    points = dense[rng.permutation(seen)[:count]]
    if noise_sigma > 0.0:
        sight = points - camera
        sight /= np.linalg.norm(sight, axis=1, keepdims=True)
        points = points + rng.normal(0.0, noise_sigma, (len(points), 1)) * sight
    return points


@dataclass(frozen=True, eq=False)
class View:
    """What one camera sees, in the frame of the surface."""

    points: Float[np.ndarray, "n 3"]
    camera: Float[np.ndarray, "3"]


def two_views(
    mesh: trimesh.Trimesh,
    rng: np.random.Generator,
    *,
    points: int,
    min_overlap: float,
    distance: tuple[float, float] = (2.0, 4.0),
    noise_sigma: float = 0.0,
    grazing_deg: float = 0.0,
    tries: int = 12,
) -> tuple[View, View, float]:
    """Two overlapping scans of a mesh in its own frame, and the radius of the mesh.

    `distance` (a range to draw from) and `noise_sigma` are in radii of the mesh, around the center
    of its bounding box. The second camera is drawn again, closer and closer to the first, until
    `scan_overlap` reaches `min_overlap`.
    """
    center = mesh.bounds.mean(axis=0)
    size = float(np.linalg.norm(mesh.vertices - center, axis=1).max())

    def view(direction: np.ndarray) -> View:
        camera = center + size * rng.uniform(*distance) * direction
        cloud = scan(
            mesh,
            camera,
            count=points,
            rng=rng,
            noise_sigma=noise_sigma * size,
            grazing_deg=grazing_deg,
        )
        return View(cloud, camera)

    first_direction = uniform_direction(rng)
    source = view(first_direction)
    for attempt in range(tries):
        widest_deg = 180.0 * (1.0 - attempt / tries)
        target = view(_turned(first_direction, rng, max_angle_deg=widest_deg))
        if scan_overlap(source.points, target.points) >= min_overlap:
            break
    else:
        raise InputError(
            f"expected views that overlap by {min_overlap}, found none in {tries} tries; "
            "lower min_overlap"
        )
    return source, target, size


def scan_pair(
    mesh: trimesh.Trimesh,
    rng: np.random.Generator,
    *,
    points: int = 2048,
    min_overlap: float = 0.3,
    distance: tuple[float, float] = (2.0, 4.0),
    noise_sigma: float = 0.0,
    grazing_deg: float = 0.0,
    name: str = "scan",
    tries: int = 12,
) -> Pair:
    """Two views of a mesh from random sides (`two_views`), each under its own random motion."""
    source, target, size = two_views(
        mesh,
        rng,
        points=points,
        min_overlap=min_overlap,
        distance=distance,
        noise_sigma=noise_sigma,
        grazing_deg=grazing_deg,
        tries=tries,
    )
    T_source_object, T_target_object = (
        rigid(uniform_rotation(rng), ball_translation(rng, max_length=size)) for _ in range(2)
    )
    return Pair(
        move(T_source_object, source.points),
        move(T_target_object, target.points),
        T_target_object @ invert(T_source_object),
        name,
        source_viewpoint=move(T_source_object, source.camera[None])[0],
        target_viewpoint=move(T_target_object, target.camera[None])[0],
    )


def scan_overlap(first: Float[np.ndarray, "n 3"], second: Float[np.ndarray, "m 3"]) -> float:
    """The smaller of the two shares of points that have a partner in the other scan.

    A partner lies within twice the median point spacing of the scan that it is in. Both scans are
    in one frame.
    """
    shares = []
    for points, others in ((first, second), (second, first)):
        tree = cKDTree(others)
        spacing = np.median(tree.query(others, k=2)[0][:, 1])
        shares.append(np.mean(tree.query(points, distance_upper_bound=2.0 * spacing)[0] < np.inf))
    return float(min(shares))


def _project(
    dense: Float[np.ndarray, "dense 3"], camera: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "dense 2"], Float[np.ndarray, "dense"]]:
    """Image coordinates x/z, y/z and depth z of a pinhole camera; behind it, depth is infinite."""
    forward = dense.mean(axis=0) - camera
    length = np.linalg.norm(forward)
    if length == 0.0:
        raise InputError("expected a camera away from the surface's mean, got the mean itself")
    forward = forward / length
    right = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
    right /= np.linalg.norm(right)
    local = (dense - camera) @ np.stack([right, np.cross(forward, right), forward], axis=1)
    depth = local[:, 2]
    front = depth > 1e-6 * length
    if not front.any():
        raise InputError("expected a surface in front of the camera, found all of it behind")
    image = local[:, :2] / np.where(front, depth, 1.0)[:, None]
    return image, np.where(front, depth, np.inf)


def _nearest_per_pixel(
    image: Float[np.ndarray, "dense 2"], depth: Float[np.ndarray, "dense"], wanted: int
) -> Bool[np.ndarray, "dense"]:
    """The nearest sample of each pixel, the pixels sized so that about `wanted` are hit."""
    front = np.isfinite(depth)
    low = image[front].min(axis=0)
    span = image[front].max(axis=0) - low
    pixel = max(float(np.sqrt(span.prod() / wanted)), float(span.max()) / wanted, 1e-12)
    # The share of the rectangle that the object fills is known only after a first count.
    some = image[front][::4]
    for _ in range(2):
        index, pixels = _pixel_index(some, low, span, pixel)
        hit = np.zeros(pixels, dtype=bool)
        hit[index] = True
        pixel *= float(np.sqrt(hit.sum() / wanted))
    index, pixels = _pixel_index(image, low, span, pixel)
    buffer = np.full(pixels, np.inf)
    np.minimum.at(buffer, index, depth)
    return front & (depth == buffer[index])


def _pixel_index(
    image: Float[np.ndarray, "dense 2"],
    low: Float[np.ndarray, "2"],
    span: Float[np.ndarray, "2"],
    pixel: float,
) -> tuple[Int[np.ndarray, "dense"], int]:
    cells = np.maximum(np.ceil(span / pixel).astype(np.int64), 1)
    # Samples behind the camera land anywhere; clipping keeps them inside, their depth is infinite.
    cell = np.clip(((image - low) / pixel).astype(np.int64), 0, cells - 1)
    return cell[:, 0] * cells[1] + cell[:, 1], int(cells.prod())


def _turned(
    direction: Float[np.ndarray, "3"], rng: np.random.Generator, *, max_angle_deg: float
) -> Float[np.ndarray, "3"]:
    """A direction at most `max_angle_deg` away, uniform over that cap of the sphere."""
    cosine = rng.uniform(np.cos(np.deg2rad(max_angle_deg)), 1.0)
    side = np.cross(direction, uniform_direction(rng))
    side /= np.linalg.norm(side)
    return cosine * direction + np.sqrt(1.0 - cosine**2) * side
