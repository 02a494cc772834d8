from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from fullturn.data import solids
from fullturn.data.families import FAMILIES
from fullturn.data.procedural import demo_object, dog, procedural_mesh
from fullturn.data.surface import sample_faces, sample_surface


def merged(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    welded = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    welded.merge_vertices(digits_vertex=9)
    return welded


@pytest.mark.parametrize(
    ("mesh", "volume"),
    [
        (solids.box((1, 2, 3)), 6.0),
        (solids.frustum(1.0, 1.0, 2.0, sections=400), 2 * np.pi),
        (solids.frustum(1.0, 0.0, 3.0, sections=400), np.pi),
        (solids.superquadric((1, 2, 3), sections=300), 8 * np.pi),
        (solids.torus(1.0, 0.2, sections=300), 2 * np.pi**2 * 0.2**2),
        (solids.prism(np.array([[1, 1], [-1, 1], [-1, -1], [1, -1.0]]), 0.5), 2.0),
        (solids.bent_sheet(1.0, 0.5, 0.1, bend_rad=0.0), 0.05),
    ],
)
def test_solids_are_closed_and_have_the_formula_s_volume(
    mesh: trimesh.Trimesh, volume: float
) -> None:
    welded = merged(mesh)
    assert welded.is_watertight
    assert abs(welded.volume) == pytest.approx(volume, rel=0.03)


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_gives_sound_meshes(family: str) -> None:
    for seed in range(10):
        mesh = FAMILIES[family](np.random.default_rng(seed))
        assert np.isfinite(mesh.vertices).all()
        assert mesh.area > 0
        assert np.ptp(mesh.vertices, axis=0).min() > 1e-3


def test_turned_shapes_are_exactly_symmetric() -> None:
    mesh = FAMILIES["turned"](np.random.default_rng(1))
    angle = 2 * np.pi / 64
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    distance = cKDTree(mesh.vertices).query(mesh.vertices @ turn.T)[0]
    assert distance.max() < 1e-9


def test_generated_meshes_fill_the_unit_ball_and_repeat() -> None:
    first, again = (procedural_mesh(np.random.default_rng(7)) for _ in range(2))
    assert np.array_equal(first.vertices, again.vertices)
    assert np.linalg.norm(first.vertices, axis=1).max() == pytest.approx(1.0)
    sample = sample_surface(first, 50_000, np.random.default_rng(0))
    assert np.abs(sample.mean(axis=0)).max() < 0.02


@pytest.mark.parametrize("make", [demo_object, dog])
def test_demo_objects_have_no_symmetry(make: Callable[[], trimesh.Trimesh]) -> None:
    points = sample_surface(make(), 4000, np.random.default_rng(0))
    tree = cKDTree(points)
    spacing = tree.query(points, k=2)[0][:, 1].mean()
    for axis in np.eye(3):
        flipped = points @ (2 * np.outer(axis, axis) - np.eye(3)).T
        mirrored = points @ (np.eye(3) - 2 * np.outer(axis, axis)).T
        assert tree.query(flipped)[0].max() > 4 * spacing
        assert tree.query(mirrored)[0].max() > 4 * spacing


def test_sampling_follows_area_and_stays_on_the_surface() -> None:
    mesh = solids.box((1.0, 2.0, 4.0))
    points, face = sample_faces(mesh, 60_000, np.random.default_rng(0))
    share = np.bincount(face, minlength=len(mesh.faces)) / len(points)
    assert np.allclose(share, mesh.area_faces / mesh.area, atol=0.01)
    on_side = np.isclose(np.abs(points), np.array([0.5, 1.0, 2.0]), atol=1e-12).any(axis=1)
    assert on_side.all()
    # Uniform inside a face, too: the mean of its points is its center.
    for i in range(3):
        center = mesh.triangles_center[i]
        assert np.abs(points[face == i].mean(axis=0) - center).max() < 0.05
