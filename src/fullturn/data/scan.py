"""Pairs of scans of one object, from random sides."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
import trimesh
from jaxtyping import Float

from fullturn.data.camera import Camera, ball_camera
from fullturn.data.motion import ball_translation, uniform_direction, uniform_rotation
from fullturn.data.overlap import scan_overlap
from fullturn.data.pair import Pair
from fullturn.data.raycast import mesh_ball
from fullturn.data.scanner import Scanner, Seen, spread
from fullturn.data.sensor import Sensor
from fullturn.errors import InputError
from fullturn.geometry.motion import invert, move, rigid

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
    max_overlap: float = 1.0,
    distance: tuple[float, float] = (2.0, 4.0),
    sensor: Sensor | None = None,
    thinning: Literal["random", "farthest"] = "random",
    name: str = "scan",
    tries: int = 12,
    backend: Literal["auto", "embree", "python"] = "auto",
) -> Pair:
    """Two views of a mesh from random sides that overlap, each under its own random motion.

    Each eye is at a distance out of the range `distance` from the middle of the mesh, in radii of
    a ball around it. The second is drawn from anywhere, then nearer to the first where the two
    clouds overlap too little, farther from it where too much, until their `scan_overlap` lies
    between `min_overlap` and `max_overlap`. A cloud is a random choice of `points` returns, or
    farthest points; it has fewer where a view has fewer returns, but at least half as many.

    Raises:
        InputError: no two such views in `tries` tries, a mesh that can't be seen (`Raycaster`), or
            a number out of its range.
        DependencyError: Embree was asked for and is not installed.
    """
    if points < 2 or tries < 1:
        raise InputError(f"expected at least 2 points and 1 try, got {points} and {tries}")
    if min_overlap > max_overlap:
        raise InputError(
            f"min_overlap: expected at most max_overlap, {max_overlap}, got {min_overlap}"
        )
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
        away = rng.uniform(*distance)
        camera = ball_camera(
            center, radius, direction, distance=away, width=_FIRST_PIXELS, height=_FIRST_PIXELS
        )
        wanted = round(_CHOICE[thinning] * points)
        return scanner.look(camera, wanted=wanted, enough=-(-points // 2), rng=rng)

    firsts = (look(uniform_direction(rng)) for _ in range(tries))
    first = next((view for view in firsts if view is not None), None)
    nothing = InputError(
        f"expected two views of {points} points that overlap by {min_overlap} to {max_overlap}, "
        f"found none in {tries} tries; lower min_overlap or raise max_overlap"
    )
    if first is None:
        raise nothing
    toward = first.camera.center - center
    nearest_deg, farthest_deg = 0.0, 180.0
    for _ in range(tries):
        angle_deg, direction = _turned(toward, rng, nearest_deg, farthest_deg)
        second = look(direction)
        if second is None:
            continue
        clouds = [view.points[:points] for view in (first, second)]
        overlap = scan_overlap(*clouds)
        if thinning == "farthest" and min_overlap <= overlap <= max_overlap:
            # Only now, for they take longer than all the rest.
            clouds = [spread(view.points, points) for view in (first, second)]
            overlap = scan_overlap(*clouds)
        if overlap < min_overlap:
            farthest_deg = angle_deg
        elif overlap > max_overlap:
            nearest_deg = angle_deg
        else:
            return _moved(clouds, [first.camera, second.camera], radius, rng, name)
    raise nothing


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


def _turned(
    direction: Float[np.ndarray, "3"],
    rng: np.random.Generator,
    nearest_deg: float,
    farthest_deg: float,
) -> tuple[float, Float[np.ndarray, "3"]]:
    """An angle between the two, and a direction that far away; uniform over the sphere between."""
    cosine = rng.uniform(*np.cos(np.deg2rad([farthest_deg, nearest_deg])))
    along = direction / np.linalg.norm(direction)
    side = np.cross(along, uniform_direction(rng))
    side /= np.linalg.norm(side)
    return math.degrees(math.acos(cosine)), cosine * along + math.sqrt(1.0 - cosine**2) * side
