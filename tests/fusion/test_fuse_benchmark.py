"""How the benchmark of `fuse` tells right poses from wrong ones, up to known symmetries."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from fusion_cases import random_pose
from scipy.spatial.transform import Rotation

from fullturn.geometry.motion import invert, move, rigid

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from fuse_cases import MovedScans, Surface, best_motion, placed_by_references, placed_by_surface


def turn(*vector_deg: float) -> np.ndarray:
    return rigid(Rotation.from_rotvec(vector_deg, degrees=True).as_matrix(), np.zeros(3))


def box(height: float = 0.5) -> trimesh.Trimesh:
    return trimesh.creation.box((2.0, 1.0, height))


def lopsided() -> trimesh.Trimesh:
    """A box with a knob at one end: a half turn is nearly a symmetry."""
    knob = trimesh.creation.box((0.3, 0.6, 0.3))
    knob.apply_translation((0.8, 0.0, 0.4))
    return trimesh.util.concatenate([box(), knob])


@pytest.mark.parametrize("motion", [turn(180, 0, 0), turn(0, 180, 0), turn(0, 2, 178)])
def test_a_turn_of_a_box_onto_itself_is_no_error(motion: np.ndarray) -> None:
    assert Surface(box()).angle_deg(motion) < 3.5


def test_any_turn_of_a_cylinder_about_its_axis_is_no_error() -> None:
    surface = Surface(trimesh.creation.cylinder(radius=0.5, height=2.0, sections=64))
    assert surface.angle_deg(turn(0, 0, 77)) < 1.0
    assert surface.angle_deg(turn(77, 0, 0)) > 30.0


def test_what_is_nearly_a_symmetry_is_an_error() -> None:
    assert Surface(lopsided()).angle_deg(turn(0, 0, 180)) > 90.0
    assert Surface(box(0.9)).angle_deg(turn(90, 0, 0)) > 45.0  # 1 × 0.9 is no square


def placed(T_world_scan: list[np.ndarray], groups: Any, scans: MovedScans) -> Any:
    fusion: Any = SimpleNamespace(T_world_scan=T_world_scan, groups=groups, names=("scan",) * 9)
    return placed_by_surface(fusion, scans, Surface(lopsided()))


def test_the_frame_of_a_group_is_that_of_most_of_its_scans() -> None:
    rng = np.random.default_rng(0)
    mesh = lopsided()
    motions = [random_pose(rng) for _ in range(5)]
    seen = [mesh.sample(400, seed=k) for k in range(5)]
    scans = MovedScans(
        [move(T, points) for T, points in zip(motions, seen, strict=True)],
        [None] * 5,
        [invert(T) for T in motions],
        ["mesh"] * 5,
    )
    world = random_pose(rng)
    found = [world @ invert(T) for T in motions]
    found[0] = world @ turn(0, 0, 180) @ invert(motions[0])
    found[3] = world @ rigid(np.eye(3), np.array([0.0, 0.0, 0.3])) @ invert(motions[3])
    (group,) = placed(found, ((0, 1, 2, 3, 4),), scans)
    assert [one.is_right for one in group] == [False, True, True, False, True]
    assert group[0].error_deg > 90.0
    # Alone, a scan is where it is.
    alone = placed(found, ((1, 2), (0,)), scans)
    assert [[one.is_right for one in group] for group in alone] == [[True, True], [True]]
    fusion: Any = SimpleNamespace(T_world_scan=found[1:3], groups=((0, 1),), names=("a", "b"))
    references = MovedScans(scans.clouds[1:3], [None] * 2, scans.T_object_scan[1:3], ["a"] * 2)
    assert all(one.error_deg < 1e-5 for one in placed_by_references(fusion, references)[0])


def test_the_best_motion_is_a_rotation_even_of_mirrored_points() -> None:
    rng = np.random.default_rng(1)
    points, T = rng.normal(size=(20, 3)), random_pose(rng)
    np.testing.assert_allclose(best_motion(points, move(T, points)), T, atol=1e-9)
    assert np.linalg.det(best_motion(points, points * (1, 1, -1))[:3, :3]) > 0.99
