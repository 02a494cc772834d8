"""What a camera sees of an object, with as many pixels as it takes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
import trimesh
from jaxtyping import Float

from fullturn.data.camera import Camera
from fullturn.data.raycast import Raycaster, back_project, mesh_ball, to_object
from fullturn.data.sensor import Sensor, sense
from fullturn.geometry.sampling import farthest_point_sample

_MOST_PIXELS = 640  # a side; a view that needs more shows next to nothing
_MOST_CHOICE = 4  # farthest points among more than four times as many only cost time


@dataclass(frozen=True, eq=False)
class Seen:
    """What one camera sees of an object."""

    points: Float[np.ndarray, "n 3"]  # in the object's frame
    camera: Camera


class Scanner:
    """A sensor that looks at one mesh, with as many pixels as it takes.

    `radius` is the length that the sensor's lengths are counted in (None: that of a ball around
    the mesh).

    Raises:
        InputError: a mesh that can't be seen (`Raycaster`).
    """

    def __init__(
        self,
        mesh: trimesh.Trimesh,
        *,
        sensor: Sensor | None = None,
        radius: float | None = None,
        backend: Literal["auto", "embree", "python"] = "auto",
    ) -> None:
        self._mesh, self._sensor = mesh, Sensor() if sensor is None else sensor
        self._radius = mesh_ball(mesh)[1] if radius is None else radius
        self._caster = Raycaster(mesh, backend=backend)

    def look(
        self, camera: Camera, *, wanted: int, enough: int, rng: np.random.Generator
    ) -> Seen | None:
        """All returns of a view, in random order; None where there are fewer than `enough`.

        Where `camera` has fewer than `wanted` returns, the same image is taken once more with as
        many pixels as should give them, up to 640 a side.
        """
        depth = self._depth(camera, rng)
        hits = int(np.isfinite(depth).sum())
        if hits < wanted:
            # Pixels grow with the square of the side; a tenth more, since edges count by halves.
            factor = 1.1 * float(np.sqrt(wanted / max(hits, 1)))
            factor = min(factor, max(_MOST_PIXELS / camera.width, 1.0))
            if hits * factor**2 < enough:
                return None
            camera = _finer(camera, factor)
            depth = self._depth(camera, rng)
        points = to_object(back_project(depth, camera), camera)
        if len(points) < enough:
            return None
        return Seen(points[rng.permutation(len(points))], camera)

    def _depth(self, camera: Camera, rng: np.random.Generator) -> Float[np.ndarray, "h w"]:
        image = self._caster.image(camera)
        return sense(image, camera, self._mesh, self._sensor, rng=rng, radius=self._radius).depth


def spread(points: Float[np.ndarray, "n 3"], count: int) -> Float[np.ndarray, "k 3"]:
    """The `count` farthest points, beginning with the first; all where there are fewer."""
    among = points[: _MOST_CHOICE * count]
    order = farthest_point_sample(torch.from_numpy(among), min(count, len(among)))
    return among[order.numpy()]


def _finer(camera: Camera, factor: float) -> Camera:
    """The same image with more pixels."""
    side = round(camera.width * factor)
    return replace(camera, focal=camera.focal * side / camera.width, width=side, height=side)
