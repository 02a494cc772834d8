"""Graphs with known poses: exact edges, with wrong poses put in by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from fullturn.fusion.edges import Edge


def random_pose(rng: np.random.Generator, *, shift: float = 1.0) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    T[:3, 3] = shift * rng.normal(size=3)
    return T


def random_poses(count: int, rng: np.random.Generator) -> np.ndarray:
    return np.stack([random_pose(rng, shift=0.4) for _ in range(count)])


def jitter(T: np.ndarray, rng: np.random.Generator, *, deg: float, shift: float) -> np.ndarray:
    small = np.eye(4)
    small[:3, :3] = Rotation.from_rotvec(np.deg2rad(deg) * rng.normal(size=3)).as_matrix()
    small[:3, 3] = shift * rng.normal(size=3)
    return T @ small


def edge(
    i: int,
    j: int,
    poses: Sequence[np.ndarray],
    probability: Sequence[float],
    *,
    is_symmetric: bool = False,
) -> Edge:
    shares = tuple((0.5, 0.5) for _ in poses)
    stack = np.stack(list(poses)) if len(poses) else np.zeros((0, 4, 4))
    return Edge(i, j, stack, np.array(probability), shares, 1e-4 * np.eye(6), is_symmetric)


def between(T_world_scan: np.ndarray, i: int, j: int) -> np.ndarray:
    return np.linalg.inv(T_world_scan[i]) @ T_world_scan[j]


def errors(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """The angle in degrees and the shift between two poses."""
    difference = np.linalg.inv(true) @ found
    angle = Rotation.from_matrix(difference[:3, :3]).magnitude()
    return float(np.rad2deg(angle)), float(np.linalg.norm(difference[:3, 3]))
