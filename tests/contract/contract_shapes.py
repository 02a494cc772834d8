"""Generated clouds for the method contract: shapes without symmetry, and unrelated ones."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def bracket(count: int, *, seed: int = 0) -> np.ndarray:
    """Points (count, 3) on an L of two boxes with a bump, uniform by area: no symmetry."""
    rng = np.random.default_rng(seed)
    long, short = ((0, 0, 0), (2.0, 0.6, 0.5)), ((0, 0.6, 0), (0.5, 1.4, 0.8))
    bump = ((1.3, 0.1, 0.5), (1.7, 0.4, 0.9))
    boxes = [np.array(box, dtype=float) for box in (long, short, bump)]
    areas = np.array([_area(box) for box in boxes])
    counts = rng.multinomial(count, areas / areas.sum())
    return np.concatenate([_on_box(box, n, rng) for box, n in zip(boxes, counts, strict=True)])


def ring(count: int, *, seed: int = 0) -> np.ndarray:
    """Points (count, 3) on a thin, wavy ring: nothing of the bracket is in it."""
    rng = np.random.default_rng(seed)
    around, across = rng.uniform(0, 2 * np.pi, (2, count))
    radius = 1.0 + 0.12 * np.cos(across)
    return np.column_stack(
        [
            radius * np.cos(around),
            0.7 * radius * np.sin(around),
            0.12 * np.sin(across) + 0.3 * np.cos(3 * around),
        ]
    )


def motion(
    rng: np.random.Generator, *, max_angle_deg: float = 180.0, size: float = 3.0
) -> np.ndarray:
    """A rigid motion (4, 4): any axis, an angle up to `max_angle_deg`, a translation."""
    axis = rng.normal(size=3)
    angle = np.radians(rng.uniform(0.5, 1.0) * max_angle_deg)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
    T[:3, 3] = rng.normal(size=3) * size
    return T


def move(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Rows of `points` moved by T."""
    return points @ T[:3, :3].T + T[:3, 3]


def pose_error(
    T_estimated: np.ndarray, T_true: np.ndarray, points: np.ndarray
) -> tuple[float, float]:
    """Rotation error (deg), and the largest displacement error over the cloud's radius."""
    R = T_true[:3, :3].T @ T_estimated[:3, :3]
    angle_deg = float(np.degrees(Rotation.from_matrix(R).magnitude()))
    radius = np.linalg.norm(points - points.mean(axis=0), axis=1).max()
    apart = np.linalg.norm(move(T_estimated, points) - move(T_true, points), axis=1).max()
    return angle_deg, float(apart / radius)


def _area(box: np.ndarray) -> float:
    x, y, z = box[1] - box[0]
    return float(x * y + y * z + z * x)


def _on_box(box: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    low, side = box[0], box[1] - box[0]
    points = low + rng.random((count, 3)) * side
    faces = np.array([side[1] * side[2], side[2] * side[0], side[0] * side[1]])
    axis = rng.choice(3, size=count, p=faces / faces.sum())
    points[np.arange(count), axis] = (low + rng.integers(0, 2, (count, 1)) * side)[
        np.arange(count), axis
    ]
    return points
