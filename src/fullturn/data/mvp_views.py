"""Two views of one object that overlap: each the farthest points of a depth image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
import trimesh
from jaxtyping import Float

from fullturn.data.camera import Camera, cameras_around
from fullturn.data.mvp_rg import MvpRgConfig
from fullturn.data.raycast import Raycaster, back_project, to_object
from fullturn.data.scan import scan_overlap
from fullturn.data.sensor import sense
from fullturn.geometry.sampling import farthest_point_sample

# Farthest points spread well when they are chosen among at least twice as many; more than four
# times as many only cost time.
_LEAST_CHOICE, _MOST_CHOICE = 2, 4
_MOST_PIXELS = 640  # a side; a view that needs more shows next to nothing
_REACH_DEG = 120.0  # views that lie farther apart share nothing, but for wires and rods


@dataclass(frozen=True, eq=False)
class Seen:
    """What one camera sees of an object."""

    points: Float[np.ndarray, "n 3"]  # in the object's frame
    camera: Camera


class Viewer:
    """Looks at one object, which lies in the unit ball, from cameras all around."""

    def __init__(self, mesh: trimesh.Trimesh, config: MvpRgConfig, rng: np.random.Generator):
        self._mesh, self._config, self._rng = mesh, config, rng
        self._caster = Raycaster(mesh)
        self.empty = 0  # views that showed too little

    def two_views(self) -> tuple[Seen, Seen, float] | None:
        """A random view, a second one that overlaps enough, and by how much; None: there are none.

        The second is the first that fits, in random order among those within reach.
        """
        config = self._config
        cameras = cameras_around(
            np.zeros(3),
            1.0,
            count=config.views,
            distance=config.distance,
            rng=self._rng,
            width=config.resolution,
            height=config.resolution,
        )
        order = iter(self._rng.permutation(len(cameras)))
        first = next(filter(None, (self._look(cameras[number]) for number in order)), None)
        if first is None:
            return None
        for number in order:
            if not _within_reach(first.camera, cameras[number]):
                continue
            second = self._look(cameras[number])
            if second is None:
                continue
            overlap = scan_overlap(first.points, second.points)
            if overlap >= config.min_overlap:
                return first, second, overlap
        return None

    def _look(self, camera: Camera) -> Seen | None:
        """The farthest points of what a camera sees, None where it sees too little."""
        count = self._config.points
        depth = self._depth(camera)
        hits = int(np.isfinite(depth).sum())
        if hits < _LEAST_CHOICE * count:
            # Pixels grow with the square of the side; a tenth more, since edges count by halves.
            factor = 1.1 * float(np.sqrt(_LEAST_CHOICE * count / max(hits, 1)))
            factor = min(factor, max(_MOST_PIXELS / camera.width, 1.0))
            if hits * factor**2 < count:
                self.empty += 1
                return None
            camera = _finer(camera, factor)
            depth = self._depth(camera)
        points = to_object(back_project(depth, camera), camera)
        if len(points) < count:
            self.empty += 1
            return None
        points = points[self._rng.permutation(len(points))[: _MOST_CHOICE * count]]
        return Seen(points[farthest_point_sample(torch.from_numpy(points), count).numpy()], camera)

    def _depth(self, camera: Camera) -> Float[np.ndarray, "h w"]:
        image = self._caster.image(camera)
        sensor = self._config.sensor
        return sense(image, camera, self._mesh, sensor, rng=self._rng, radius=1.0).depth


def _finer(camera: Camera, factor: float) -> Camera:
    """The same image with more pixels."""
    side = round(camera.width * factor)
    return replace(camera, focal=camera.focal * side / camera.width, width=side, height=side)


def _within_reach(first: Camera, second: Camera) -> bool:
    a, b = first.center, second.center
    cosine = a @ b / (np.linalg.norm(a) * np.linalg.norm(b))
    return bool(cosine > np.cos(np.deg2rad(_REACH_DEG)))
