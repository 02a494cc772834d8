"""What a pinhole camera sees of a triangle mesh: one ray a pixel, exact depths."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import trimesh
from jaxtyping import Float, Int

from fullturn.data.camera import Camera, bounding_ball
from fullturn.errors import DependencyError, InputError
from fullturn.geometry.motion import invert, move

# Work at once: faces whose boxes are found, and pairs of a face and a pixel that are tested.
_FACES_AT_ONCE = 1 << 17
_PAIRS_AT_ONCE = 1 << 18
# A triangle is degenerate where its height is this small against its longest edge.
_FLAT = 1e-12
# Of a product of two corners and a ray, over the square of the largest corner.
_ROUNDING = 4e-15
# Pixels; wider than the rounding of a projection, so that no box is too small.
_MARGIN = 1e-6


@dataclass(frozen=True, eq=False)
class DepthImage:
    """What each pixel sees."""

    depth: Float[np.ndarray, "h w"]  # along the camera's z axis; inf where nothing was hit
    face: Int[np.ndarray, "h w"]  # index of the face; -1 where nothing was hit


class Raycaster:
    """Depth images of one mesh, from anywhere.

    Faces are seen from both sides, so a camera may be inside, and winding doesn't matter.
    Degenerate faces are never hit. `backend`: "embree" needs the package embreex; "python" is a
    z-buffer over the pixels in each triangle's box, in NumPy; "auto" takes Embree where it is
    installed. Both say which face a pixel sees; its depth then comes from the plane of that face,
    in float64.

    Raises:
        InputError: a mesh without faces of any area, with vertices that are not finite, or with
            faces that name no vertex.
        DependencyError: Embree was asked for and is not installed.
    """

    def __init__(
        self, mesh: trimesh.Trimesh, *, backend: Literal["auto", "embree", "python"] = "auto"
    ) -> None:
        if backend not in ("auto", "embree", "python"):
            raise InputError(f"backend: expected auto, embree or python, got {backend!r}")
        self._corners, self._index = usable_faces(mesh)
        self._embree = None if backend == "python" else _Embree.build(self._corners)
        if backend == "embree" and self._embree is None:
            raise DependencyError(
                'the backend "embree" needs embreex, which is not installed; '
                'pip install "fullturn[data]"'
            )

    @property
    def backend(self) -> str:
        """The backend at work: "embree" or "python"."""
        return "python" if self._embree is None else "embree"

    def image(self, camera: Camera) -> DepthImage:
        """What `camera` sees; all of it inf where it sees nothing."""
        if self._embree is None:
            seen = _first_faces(_move_corners(camera.T_camera_object, self._corners), camera)
        else:
            seen = self._embree.first_faces(camera)
        hit = seen >= 0
        corners = _move_corners(camera.T_camera_object, self._corners[seen[hit]])
        depth = np.full(seen.shape, np.inf)
        depth[hit] = _plane_depth(corners, camera.rays()[hit])
        face = np.full(seen.shape, -1, dtype=np.int64)
        face[hit] = self._index[seen[hit]]
        return DepthImage(depth, face)


def back_project(depth: Float[np.ndarray, "h w"], camera: Camera) -> Float[np.ndarray, "n 3"]:
    """The points of all finite pixels, row by row, in the camera's frame."""
    seen = np.isfinite(depth)
    return camera.rays()[seen] * depth[seen][:, None]


def to_object(points: Float[np.ndarray, "n 3"], camera: Camera) -> Float[np.ndarray, "n 3"]:
    """Points of the camera's frame, in the frame of the object."""
    return move(invert(camera.T_camera_object), points)


def usable_faces(
    mesh: trimesh.Trimesh,
) -> tuple[Float[np.ndarray, "f 3 3"], Int[np.ndarray, " f"]]:
    """The corners of all faces that have an area, and which faces these are.

    Raises:
        InputError: there are none, a vertex is not finite, or a face names no vertex.
    """
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    faces = np.asarray(mesh.faces, dtype=np.int64)
    if len(faces) == 0:
        raise InputError("expected a mesh with faces, got none; a cloud of points can't be seen")
    if not np.isfinite(vertices).all():
        raise InputError(
            f"expected finite vertices, got {int((~np.isfinite(vertices)).any(axis=1).sum())} with "
            "NaN or infinite coordinates; remove them and their faces"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(
            f"expected faces that index {len(vertices)} vertices, got indices from {faces.min()} "
            f"to {faces.max()}; the mesh is damaged"
        )
    corners = vertices[faces]
    edges = np.roll(corners, -1, axis=1) - corners
    # By its longest edge, so that no square over- or underflows.
    longest = np.abs(edges).max(axis=(1, 2), initial=0.0)
    unit = edges / np.where(longest > 0.0, longest, 1.0)[:, None, None]
    index = np.flatnonzero(np.linalg.norm(np.cross(unit[:, 0], unit[:, 1]), axis=1) > _FLAT)
    if len(index) == 0:
        raise InputError(
            f"expected a mesh with a surface, its {len(faces)} faces have no area; check the mesh"
        )
    return corners[index], index


def mesh_ball(mesh: trimesh.Trimesh) -> tuple[Float[np.ndarray, "3"], float]:
    """A ball around all faces that have an area; vertices without a face don't count."""
    return bounding_ball(usable_faces(mesh)[0].reshape(-1, 3))


def _move_corners(
    T_camera_object: Float[np.ndarray, "4 4"], corners: Float[np.ndarray, "f 3 3"]
) -> Float[np.ndarray, "f 3 3"]:
    """The corners of triangles in the camera's frame; equal corners stay equal to the bit."""
    return move(T_camera_object, corners.reshape(-1, 3)).reshape(-1, 3, 3)


def _plane_depth(
    corners: Float[np.ndarray, "k 3 3"], rays: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, " k"]:
    """Where each ray d meets the plane of its triangle: a·n / d·n, within the triangle's depths.

    The limits only matter for a triangle seen edge-on, whose plane the ray meets anywhere.
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        depth = (corners[:, 0] * normal).sum(axis=1) / (rays * normal).sum(axis=1)
    nearest = np.maximum(corners[..., 2].min(axis=1), 0.0)
    return np.clip(np.where(np.isnan(depth), nearest, depth), nearest, corners[..., 2].max(axis=1))


def _first_faces(corners: Float[np.ndarray, "f 3 3"], camera: Camera) -> Int[np.ndarray, "h w"]:
    """The nearest triangle of each pixel, -1 for none: a z-buffer, many triangles at once.

    With the eye in the origin, a ray d passes through the triangle abc, or through its mirror image
    behind the eye, where d·(b×c), d·(c×a) and d·(a×b) have one sign. The products of a shared edge
    are equal to the bit, so no ray slips between two triangles, and zero to rounding is of either
    sign, so none slips through the corner of many. Of equally near ones, the first.
    """
    depth = np.full(camera.height * camera.width, np.inf)
    face = np.full(len(depth), -1, dtype=np.int64)
    rays = camera.rays().reshape(-1, 3)
    for start in range(0, len(corners), _FACES_AT_ONCE):
        block = corners[start : start + _FACES_AT_ONCE]
        low, high = _pixel_boxes(block, camera)
        a, b, c = block.transpose(1, 0, 2)
        sides = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
        rounding = _ROUNDING * np.square(block).sum(axis=2).max(axis=1, keepdims=True)
        for which, pixel in _pairs(low, high, camera.width):
            ray = rays[pixel]
            side = (sides[which] * ray[:, None, :]).sum(axis=2)
            zero = rounding[which]
            inside = (side >= -zero).all(axis=1) | (side <= zero).all(axis=1)
            which, pixel = which[inside], pixel[inside]
            away = _plane_depth(block[which], ray[inside])
            nearer = (away > 0.0) & (away < depth[pixel])
            which, pixel, away = which[nearer], pixel[nearer], away[nearer]
            np.minimum.at(depth, pixel, away)
            won = away == depth[pixel]
            # Backwards, since of several values for one pixel the last one stays.
            face[pixel[won][::-1]] = start + which[won][::-1]
    return face.reshape(camera.height, camera.width)


def _pixel_boxes(
    corners: Float[np.ndarray, "f 3 3"], camera: Camera
) -> tuple[Int[np.ndarray, "f 2"], Int[np.ndarray, "f 2"]]:
    """First and last (column, row) of the pixels that each triangle may cover; last < first: none.

    A triangle that reaches behind the eye may cover the whole image.
    """
    size = np.array([camera.width, camera.height])
    z = corners[..., 2:]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        at = corners[..., :2] / z * camera.focal + (size - 1.0) / 2.0
    low = np.clip(np.ceil(at.min(axis=1) - _MARGIN), 0.0, size)
    high = np.clip(np.floor(at.max(axis=1) + _MARGIN), -1.0, size - 1.0)
    behind = (z <= 0.0).any(axis=1)
    low = np.where(behind, 0.0, low)
    high = np.where(behind, size - 1.0, high)
    return low.astype(np.int64), np.where((z > 0.0).any(axis=1), high, -1.0).astype(np.int64)


def _pairs(
    low: Int[np.ndarray, "f 2"], high: Int[np.ndarray, "f 2"], width: int
) -> Iterator[tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]]:
    """All pairs (triangle, pixel of its box), in portions of a limited size or of one box."""
    span = np.maximum(high - low + 1, 0)
    area = span.prod(axis=1)
    filled = np.flatnonzero(area)
    portion = np.cumsum(area[filled]) // _PAIRS_AT_ONCE
    for which in np.split(filled, np.flatnonzero(np.diff(portion)) + 1):
        count = area[which]
        number = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        triangle = np.repeat(which, count)
        row, column = np.divmod(number, span[triangle, 0])
        yield triangle, (low[triangle, 1] + row) * width + low[triangle, 0] + column


class _Embree:
    """Embree's scene of the triangles, scaled to a ball of radius 1 for its single precision."""

    def __init__(self, scene: Any, center: Float[np.ndarray, "3"], radius: float) -> None:
        self._scene, self._center, self._radius = scene, center, radius

    @classmethod
    def build(cls, corners: Float[np.ndarray, "f 3 3"]) -> _Embree | None:
        """The scene, or None where Embree is not installed."""
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError:
            return None
        center, radius = bounding_ball(corners.reshape(-1, 3))
        # Shared edges are watertight only in the robust mode.
        scene = EmbreeScene(robust=True)
        scaled = ((corners.reshape(-1, 3) - center) / radius).astype(np.float32)
        TriangleMesh(
            scene=scene,
            vertices=scaled,
            indices=np.arange(len(scaled), dtype=np.int32).reshape(-1, 3),
        )
        return cls(scene, center, radius)

    def first_faces(self, camera: Camera) -> Int[np.ndarray, "h w"]:
        """The nearest triangle of each pixel, -1 for none."""
        rays = camera.rays().reshape(-1, 3)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        rays = rays @ camera.T_camera_object[:3, :3]
        eye = (camera.center - self._center) / self._radius
        # From a far eye, rays start shortly before the ball: single precision has 7 digits.
        ahead = max(float(np.linalg.norm(eye)) - 1.5, 0.0)
        seen = self._scene.run((eye + ahead * rays).astype(np.float32), rays.astype(np.float32))
        return np.asarray(seen, dtype=np.int64).reshape(camera.height, camera.width)
