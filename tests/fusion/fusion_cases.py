"""Graphs and scans with known poses: exact edges, with wrong poses put in by hand."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from fullturn.fusion.edges import Edge
from fullturn.fusion.scans import Scan, check_scans
from fullturn.geometry.normals import estimate_normals

HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
LOOKS = np.array([[1, 1, 1], [1, -1, 1], [1, 1, -1], [-1, 1, 1], [-1, -1, -1], [-1, -1, 1.0]])


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
    symmetry: int | None = None,
) -> Edge:
    shares = tuple((0.5, 0.5) for _ in poses)
    stack = np.stack(list(poses)) if len(poses) else np.zeros((0, 4, 4))
    return Edge(i, j, stack, np.array(probability), shares, 1e-4 * np.eye(6), symmetry)


def between(T_world_scan: np.ndarray, i: int, j: int) -> np.ndarray:
    return np.linalg.inv(T_world_scan[i]) @ T_world_scan[j]


def errors(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """The angle in degrees and the shift between two poses."""
    difference = np.linalg.inv(true) @ found
    angle = Rotation.from_matrix(difference[:3, :3]).magnitude()
    return float(np.rad2deg(angle)), float(np.linalg.norm(difference[:3, 3]))


def surface(*, bump: float, count: int = 9000) -> torch.Tensor:
    """An ellipsoid, with a bump at +x that alone tells the half turn about z."""
    u = np.random.default_rng(0).normal(size=(count, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    peak = 1 + bump * np.exp(-np.square(u - [1.0, 0.0, 0.0]).sum(1, keepdims=True) / 0.2)
    return torch.from_numpy(u * (1.0, 0.8, 0.6) * peak)


def seen_from(points: torch.Tensor, look: np.ndarray) -> np.ndarray:
    """The points of a surface without overhangs whose normals turn to a far sensor."""
    normals = estimate_normals(points, k=12, orientation="centroid")
    front = normals @ torch.from_numpy(look / np.linalg.norm(look)) > 0.1
    return points[front].numpy()


def case(
    bump: float, seed: int, *, right: float = 0.4
) -> tuple[list[Scan], np.ndarray, np.ndarray, list[Edge]]:
    """Scans, their true poses, the same with half of them turned, and edges that prefer these.

    The edges between both halves give the true poses the probability `right`.
    """
    rng = np.random.default_rng(seed)
    points = surface(bump=bump)
    motions = random_poses(len(LOOKS), rng)
    clouds = [
        (seen_from(points, look) - T[:3, 3]) @ T[:3, :3]
        for T, look in zip(motions, LOOKS, strict=True)
    ]
    scans, _ = check_scans(clouds)
    truth = motions.copy()
    for T, scan in zip(truth, scans, strict=True):
        T[:3, 3] += T[:3, :3] @ scan.center
    turned = truth.copy()
    turned[3:] = HALF_TURN @ turned[3:]
    edges = []
    for i, j in combinations(range(len(scans)), 2):
        if (i < 3) == (j < 3):
            edges.append(edge(i, j, [between(truth, i, j)], [0.9]))
        else:
            poses = [between(turned, i, j), between(truth, i, j)]
            edges.append(edge(i, j, poses, [0.9 - right, right]))
    return scans, truth, turned, edges
