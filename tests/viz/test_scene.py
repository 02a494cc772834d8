"""Thinning, viewpoints and partner distances against brute force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from fullturn.errors import InputError
from fullturn.geometry.motion import move
from fullturn.io import load_cloud
from fullturn.viz import scene as module
from fullturn.viz.scene import angle_axis, choose, make_scene, viewing_axes


def test_axes_of_view_are_a_right_handed_frame(make_pair, shape):
    source, _, _ = make_pair(shape)
    axes = viewing_axes(source)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)


def test_axes_of_view_face_the_broad_side():
    rng = np.random.default_rng(0)
    for _ in range(20):
        R = Rotation.random(random_state=rng).as_matrix()
        flat = (rng.normal(size=(200, 3)) * (3.0, 2.0, 0.01)) @ R.T
        across = np.abs(viewing_axes(flat)[2] @ R[:, 2])
        assert across > np.cos(np.deg2rad(35.0))


def test_choice_is_ascending_unique_and_always_the_same():
    for total, count in ((10, 20), (20, 20), (1000, 30), (5, 0)):
        chosen = choose(total, count)
        assert len(chosen) == min(total, count)
        assert (np.diff(chosen) > 0).all()
        np.testing.assert_array_equal(chosen, choose(total, count))


def test_distances_are_those_of_brute_force(make_pair, shape):
    source, target, result = make_pair(shape, count=60)
    scene = make_scene(source, target, result, max_points=50, max_alternatives=2)
    poses = [result.T_target_source, *(other.T_target_source for other in result.alternatives)]
    assert len(scene.distances) == 3
    atol = 1e-8 * (1.0 + np.abs(source).max())
    for T, found in zip(poses, scene.distances, strict=True):
        expected = cdist(move(T, scene.source), target).min(axis=1)
        np.testing.assert_allclose(found.source, expected, atol=atol)
        expected = cdist(scene.target, move(T, source)).min(axis=1)
        np.testing.assert_allclose(found.target, expected, atol=atol)


def test_scene_keeps_the_input_and_counts_all_points(make_pair):
    source, target, result = make_pair(count=500)
    before = source.copy(), target.copy()
    scene = make_scene(source, target, result, max_points=100, max_matches=40)
    assert (scene.source_total, scene.target_total) == (500, 400)
    assert (len(scene.source), len(scene.target)) == (100, 100)
    assert len(scene.matches.weight) == 40
    np.testing.assert_array_equal(source, before[0])
    np.testing.assert_array_equal(target, before[1])


def test_matches_join_the_points_they_name(make_pair):
    source, target, result = make_pair(matches=30)
    scene = make_scene(source, target, result, max_points=10, max_matches=30)
    np.testing.assert_array_equal(scene.matches.source, source[result.matches[:, 0]])
    np.testing.assert_array_equal(scene.matches.target, target[result.matches[:, 1]])


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        np.zeros((5, 2)),
        np.zeros(3),
        np.full((4, 3), np.nan),
        [[0.0, 1.0], [2.0]],
        "scan.ply",
        load_cloud(np.eye(3)),
        torch.eye(3, requires_grad=True),
    ],
)
def test_unusable_points_are_named(make_pair, points):
    _, target, result = make_pair()
    with pytest.raises(InputError, match="source_points: expected"):
        make_scene(points, target, result, max_points=10)


@pytest.mark.parametrize("index", [-1, 10_000])
def test_matches_of_other_clouds_are_refused(make_pair, index):
    source, target, result = make_pair()
    matches = result.matches.copy()
    matches[3, 1] = index
    with pytest.raises(InputError, match="pass the points that were registered"):
        make_scene(source, target, replace(result, matches=matches), max_points=9, max_matches=200)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 1.0, np.pi - 1e-7, np.pi])
def test_angle_and_axis_give_the_rotation_back(angle):
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(angle * axis).as_matrix()
    found_deg, found_axis = angle_axis(T)
    assert found_deg == pytest.approx(np.rad2deg(angle), abs=1e-7)
    assert np.linalg.norm(found_axis) == pytest.approx(1.0)
    again = Rotation.from_rotvec(np.deg2rad(found_deg) * found_axis).as_matrix()
    np.testing.assert_allclose(again, T[:3, :3], atol=1e-9)


def test_examples_in_the_docstrings():
    import doctest

    assert doctest.testmod(module).failed == 0


def test_stray_points_are_not_drawn(make_pair):
    source, target, result = make_pair(count=200)
    stray = source.mean(0) + 1000 * np.ptp(source, axis=0)
    scene = make_scene(np.vstack([source, stray]), target, result, max_points=1000)
    np.testing.assert_array_equal(scene.source, source)
    assert scene.source_total == 201
