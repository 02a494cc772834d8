"""Scans under random motions, for `fuse.py`, and which of them a fusion put where they belong."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from fullturn.data.motion import ball_translation, uniform_rotation
from fullturn.data.mvp_rg import MvpRgConfig
from fullturn.data.mvp_views import cameras_of, view_of
from fullturn.data.scanner import Scanner
from fullturn.data.surface import sample_surface
from fullturn.evaluation.metrics import rotation_error_deg
from fullturn.fusion.result import Fusion
from fullturn.geometry.diameter import diameter
from fullturn.geometry.motion import invert, move, nearest_rotation, rigid
from fullturn.io import load_cloud

WITHIN_DEG = 5.0
VIEWS, OUT_OF, POINTS = 8, 26, 2048
_SURFACE_POINTS, _ASKED_POINTS = 60_000, 500
_SAME_SURFACE, _ON_SURFACE = 0.005, 0.01  # mean distances, in diameters
_ROUNDS = 25


@dataclass(frozen=True, eq=False)
class MovedScans:
    """Scans under random motions, and those that bring them back; in random order."""

    clouds: list[np.ndarray]
    viewpoints: list[np.ndarray | None]  # where the sensors stood, in each scan's own frame
    T_object_scan: list[np.ndarray]
    objects: list[str]  # what each one shows


@dataclass(frozen=True)
class Placed:
    """One scan of a group, in the frame in which most of its group's scans are right."""

    error_deg: float
    is_right: bool


class Surface:
    """The complete surface of a mesh: which motions leave it as it is."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        points = sample_surface(mesh, _SURFACE_POINTS, np.random.default_rng(0))
        self._some, self._points = points[:_ASKED_POINTS], points
        self._tree = cKDTree(points)
        self._diameter = diameter(np.asarray(mesh.vertices))
        # Two samples of one surface do not lie on one another.
        self._gap = float(self._tree.query(self._some, k=2)[0][:, 1].mean())

    def angle_deg(self, error: np.ndarray) -> float:
        """The angle of a motion of the mesh, or to the symmetry near it, whichever is smaller."""
        angle = float(rotation_error_deg(error, np.eye(4)))
        symmetry = self._symmetry_near(error) if angle >= WITHIN_DEG else None
        return angle if symmetry is None else float(rotation_error_deg(error, symmetry))

    def _symmetry_near(self, motion: np.ndarray) -> np.ndarray | None:
        """The motion of the surface onto itself that ICP finds from another; None: none."""
        T = motion
        for _ in range(_ROUNDS):
            moved = move(T, self._some)
            distance, partner = self._tree.query(moved)
            near = distance <= 3.0 * np.median(distance) + 1e-12
            step = best_motion(moved[near], self._points[partner[near]])
            T = step @ T
            if rotation_error_deg(step, np.eye(4)) < 0.01:
                break
        # Both ways: a part may lie on a whole that it isn't.
        away = max(self._away(move(motion, self._some)) for motion in (T, invert(T)))
        return T if away - self._gap < _SAME_SURFACE * self._diameter else None

    def holds(self, points: np.ndarray, true: np.ndarray) -> bool:
        """Whether points lie on the surface, on average, where `true` is where they should be.

        Those, too, lie beside the sample that stands for the surface: that distance doesn't count.
        """
        return self._away(points) - self._away(true) < _ON_SURFACE * self._diameter

    def _away(self, points: np.ndarray) -> float:
        return float(self._tree.query(points)[0].mean())


def views_of(mesh: trimesh.Trimesh, rng: np.random.Generator) -> MovedScans | None:
    """Some of the views around a mesh in the unit ball; None where too few show enough of it."""
    rules = MvpRgConfig(views=OUT_OF, points=POINTS)
    scanner = Scanner(mesh, sensor=rules.sensor, radius=1.0)
    cameras = cameras_of(rules, rng)
    looks = (view_of(scanner, cameras[k], rules, rng) for k in rng.permutation(len(cameras)))
    seen = [view for _, view in zip(range(VIEWS), filter(None, looks), strict=False)]
    if len(seen) < VIEWS:
        return None
    motions = [_random_motion(rng, 1.0) for _ in seen]
    return MovedScans(
        [move(T, view.points) for T, view in zip(motions, seen, strict=True)],
        [move(T, view.camera.center[None])[0] for T, view in zip(motions, seen, strict=True)],
        [invert(T) for T in motions],
        ["mesh"] * VIEWS,
    )


def stanford(folder: Path, names: Sequence[str], rng: np.random.Generator) -> MovedScans:
    """All scans of real objects, mixed, with the poses that come with them as the truth."""
    found = []
    for name in names:
        poses = json.loads((folder / name / "poses.json").read_text(encoding="utf-8"))
        found += [(name, folder / name / file, np.array(T)) for file, T in sorted(poses.items())]
    found = [found[k] for k in rng.permutation(len(found))]
    clouds, T_object_scan = [], []
    for _, path, T_world_scan in found:
        points = load_cloud(path).points
        motion = _random_motion(rng, float(np.linalg.norm(np.ptp(points, axis=0))))
        clouds.append(move(motion, points))
        T_object_scan.append(T_world_scan @ invert(motion))
    return MovedScans(clouds, [None] * len(found), T_object_scan, [name for name, *_ in found])


def placed_by_references(fusion: Fusion, scans: MovedScans) -> list[list[Placed]]:
    """Per group, the angle of each scan to its reference, the group turned onto them best."""
    result = []
    for group in fusion.groups:
        errors = [_found(fusion, scan) @ invert(scans.T_object_scan[scan]) for scan in group]
        mean = Rotation.from_matrix([T[:3, :3] for T in errors]).mean().as_matrix()
        angles = [float(rotation_error_deg(T, rigid(mean, np.zeros(3)))) for T in errors]
        result.append([Placed(angle, angle < WITHIN_DEG) for angle in angles])
    return result


def placed_by_surface(fusion: Fusion, scans: MovedScans, surface: Surface) -> list[list[Placed]]:
    """Per group, how far each scan is from right, up to the symmetries of the mesh.

    Every scan's own frame is tried as the group's; that in which most are right is taken.
    """
    result = []
    for group in fusion.groups:
        tries = []
        for first in group:
            T_object_group = scans.T_object_scan[first] @ invert(_found(fusion, first))
            placed = []
            for scan in group:
                T_object_scan = T_object_group @ _found(fusion, scan)
                error = T_object_scan @ invert(scans.T_object_scan[scan])
                angle = surface.angle_deg(error)
                lies = surface.holds(
                    move(T_object_scan, scans.clouds[scan]),
                    move(scans.T_object_scan[scan], scans.clouds[scan]),
                )
                placed.append(Placed(angle, angle < WITHIN_DEG and lies))
            tries.append(placed)
            if all(one.is_right for one in placed):
                break
        result.append(max(tries, key=lambda placed: sum(one.is_right for one in placed)))
    return result


def best_motion(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """The rigid motion that brings points onto others best (Kabsch)."""
    a, b = points.mean(0), others.mean(0)
    R = nearest_rotation((others - b).T @ (points - a))
    return rigid(R, b - R @ a)


def _found(fusion: Fusion, scan: int) -> np.ndarray:
    T = fusion.T_world_scan[scan]
    if T is None:
        raise SystemExit(f"expected all scans to be used, {fusion.names[scan]} was left out")
    return T


def _random_motion(rng: np.random.Generator, size: float) -> np.ndarray:
    return rigid(uniform_rotation(rng), ball_translation(rng, max_length=size))
