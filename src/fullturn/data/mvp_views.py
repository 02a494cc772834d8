"""Two views of one object that overlap: each the farthest points of a depth image."""

from __future__ import annotations

import numpy as np
import trimesh

from fullturn.data.camera import Camera, cameras_around
from fullturn.data.mvp_rg import MvpRgConfig
from fullturn.data.overlap import scan_overlap
from fullturn.data.raycast import mesh_ball
from fullturn.data.scanner import Scanner, Seen, spread
from fullturn.errors import InputError

_LEAST_CHOICE = 2  # farthest points spread well when chosen among at least twice as many
_REACH_DEG = 120.0  # views that lie farther apart share nothing, but for wires and rods


class Viewer:
    """Looks at one object, which lies in the unit ball, from cameras all around."""

    def __init__(self, mesh: trimesh.Trimesh, config: MvpRgConfig, rng: np.random.Generator):
        self._config, self._rng = config, rng
        self._scanner = Scanner(mesh, sensor=config.sensor, radius=1.0)
        self.empty = 0  # views that showed too little

    def two_views(self) -> tuple[Seen, Seen, float] | None:
        """A random view, a second one that overlaps enough, and by how much; None: there are none.

        The second is the first that fits, in random order among those within reach.
        """
        config = self._config
        cameras = cameras_of(config, self._rng)
        order = iter(self._rng.permutation(len(cameras)))
        first = next(filter(None, (self._look(cameras[number]) for number in order)), None)
        if first is None:
            return None
        for number in order:
            if not within_reach(first.camera, cameras[number]):
                continue
            second = self._look(cameras[number])
            if second is None:
                continue
            overlap = scan_overlap(first.points, second.points)
            if overlap >= config.min_overlap:
                return first, second, overlap
        return None

    def _look(self, camera: Camera) -> Seen | None:
        seen = view_of(self._scanner, camera, self._config, self._rng)
        self.empty += seen is None
        return seen


def cameras_of(config: MvpRgConfig, rng: np.random.Generator) -> list[Camera]:
    """Those around an object in the unit ball."""
    return cameras_around(
        np.zeros(3),
        1.0,
        count=config.views,
        distance=config.distance,
        rng=rng,
        width=config.resolution,
        height=config.resolution,
    )


def view_of(
    scanner: Scanner, camera: Camera, config: MvpRgConfig, rng: np.random.Generator
) -> Seen | None:
    """The farthest points of what a camera sees, None where it sees too little."""
    count = config.points
    seen = scanner.look(camera, wanted=_LEAST_CHOICE * count, enough=count, rng=rng)
    return None if seen is None else Seen(spread(seen.points, count), seen.camera)


def within_reach(first: Camera, second: Camera) -> bool:
    """Whether views from both eyes may overlap."""
    a, b = first.center, second.center
    cosine = a @ b / (np.linalg.norm(a) * np.linalg.norm(b))
    return bool(cosine > np.cos(np.deg2rad(_REACH_DEG)))


def in_unit_ball(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh in the ball of radius 1 around the middle of its bounding box.

    Raises:
        InputError: it has no usable surface.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        center, radius = mesh_ball(mesh)
        if not 0.0 < radius < np.inf:
            raise InputError(f"expected a mesh of finite size, got the radius {radius}; scale it")
        return trimesh.Trimesh((mesh.vertices - center) / radius, mesh.faces, process=False)
