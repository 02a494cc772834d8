"""Pairs of scans of one object, from random sides."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Literal

import numpy as np
import trimesh
from jaxtyping import Float

from fullturn.data.camera import Camera, look_at
from fullturn.data.motion import (
    ball_translation,
    invert,
    move,
    rigid,
    uniform_direction,
    uniform_rotation,
)
from fullturn.data.overlap import scan_overlap
from fullturn.data.pair import Pair
from fullturn.data.raycast import mesh_ball
from fullturn.data.scanner import Scanner, Seen, spread
from fullturn.data.sensor import Sensor
from fullturn.errors import InputError

# Returns asked for, in numbers of wanted points, so that a choice is left; farthest points need a
# larger one to spread well.
_CHOICE = {"random": 1.2, "farthest": 1.6}
_FIRST_PIXELS = 48  # a side, of the look that says how many pixels it takes


def scan_pair(
    mesh: trimesh.Trimesh,
    rng: np.random.Generator,
    *,
    points: int = 2048,
    min_overlap: float = 0.3,
    distance: tuple[float, float] = (2.0, 4.0),
    sensor: Sensor | None = None,
    thinning: Literal["random", "farthest"] = "random",
    name: str = "scan",
    tries: int = 12,
    backend: Literal["auto", "embree", "python"] = "auto",
) -> Pair:
    """Two views of a mesh from random sides that overlap, each under its own random motion.

    Each eye is at a distance out of the range `distance` from the middle of the mesh, in radii of
    a ball around it. The second is drawn nearer and nearer to the first until `scan_overlap` of the
    two clouds reaches `min_overlap`. A cloud is a random choice of `points` returns, or farthest
    points; it has fewer where a view has fewer returns, but at least half as many.

    Raises:
        InputError: no two such views in `tries` tries, a mesh that can't be seen (`Raycaster`), or
            a number out of its range.
        DependencyError: Embree was asked for and is not installed.
    """
    if points < 2 or tries < 1:
        raise InputError(f"expected at least 2 points and 1 try, got {points} and {tries}")
    if not 1.0 < distance[0] <= distance[1] < math.inf:
        raise InputError(
            "distance: expected a range above 1 radius, so that the eye is outside, got "
            f"{distance[0]} to {distance[1]}"
        )
    if thinning not in _CHOICE:
        raise InputError(f"thinning: expected random or farthest, got {thinning!r}")
    center, radius = mesh_ball(mesh)
    scanner = Scanner(mesh, sensor=sensor, radius=radius, backend=backend)

    def look(direction: np.ndarray) -> Seen | None:
        camera = _camera(center, radius, direction, distance=rng.uniform(*distance))
        wanted = round(_CHOICE[thinning] * points)
        return scanner.look(camera, wanted=wanted, enough=-(-points // 2), rng=rng)

    for views in _two_views(look, center, rng, tries=tries):
        clouds = [view.points[:points] for view in views]
        if scan_overlap(*clouds) < min_overlap:
            continue
        if thinning == "farthest":
            # Only now, for they take longer than all the rest.
            clouds = [spread(view.points, points) for view in views]
            if scan_overlap(*clouds) < min_overlap:
                continue
        return _moved(clouds, [view.camera for view in views], radius, rng, name)
    raise InputError(
        f"expected two views of {points} points that overlap by {min_overlap}, found none in "
        f"{tries} tries; lower min_overlap"
    )


def _two_views(
    look: Callable[[np.ndarray], Seen | None],
    center: Float[np.ndarray, "3"],
    rng: np.random.Generator,
    *,
    tries: int,
) -> Iterator[tuple[Seen, Seen]]:
    """A view from a random side, and second ones, nearer and nearer to it."""
    firsts = (look(uniform_direction(rng)) for _ in range(tries))
    first = next((view for view in firsts if view is not None), None)
    if first is None:
        return
    toward = first.camera.center - center
    toward /= np.linalg.norm(toward)
    for attempt in range(tries):
        widest_deg = 180.0 * (1.0 - attempt / tries)
        second = look(_turned(toward, rng, max_angle_deg=widest_deg))
        if second is not None:
            yield first, second


def _moved(
    clouds: Sequence[Float[np.ndarray, "_ 3"]],
    cameras: Sequence[Camera],
    radius: float,
    rng: np.random.Generator,
    name: str,
) -> Pair:
    """The pair of two views, each under its own motion."""
    motions = [
        rigid(uniform_rotation(rng), ball_translation(rng, max_length=radius)) for _ in clouds
    ]
    source, target = (move(*both) for both in zip(motions, clouds, strict=True))
    source_viewpoint, target_viewpoint = (
        move(motion, camera.center[None])[0]
        for motion, camera in zip(motions, cameras, strict=True)
    )
    return Pair(
        source,
        target,
        motions[1] @ invert(motions[0]),
        name,
        source_viewpoint=source_viewpoint,
        target_viewpoint=target_viewpoint,
    )


def _camera(
    center: Float[np.ndarray, "3"],
    radius: float,
    direction: Float[np.ndarray, "3"],
    *,
    distance: float,
) -> Camera:
    """A camera whose image just holds the ball."""
    return look_at(
        center + distance * radius * direction,
        center,
        fov_deg=math.degrees(2.0 * math.asin(1.0 / distance)),
        width=_FIRST_PIXELS,
        height=_FIRST_PIXELS,
    )


def _turned(
    direction: Float[np.ndarray, "3"], rng: np.random.Generator, *, max_angle_deg: float
) -> Float[np.ndarray, "3"]:
    """A direction at most `max_angle_deg` away, uniform over that cap of the sphere."""
    cosine = rng.uniform(np.cos(np.deg2rad(max_angle_deg)), 1.0)
    side = np.cross(direction, uniform_direction(rng))
    side /= np.linalg.norm(side)
    return cosine * direction + np.sqrt(1.0 - cosine**2) * side
