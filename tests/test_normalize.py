"""Normalizing and back: poses by composition, covariances by finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from fullturn.geometry import rigid
from fullturn.geometry.extent import center_and_radius
from fullturn.normalize import Normalization, normalization_of, normalized_clouds

RNG = np.random.default_rng(0)


def random_frame(offset: float, length: float) -> Normalization:
    return Normalization(RNG.normal(size=3) * offset, RNG.normal(size=3) * offset, length)


def random_pose() -> np.ndarray:
    return rigid.exp_se3(torch.from_numpy(RNG.normal(size=6))).numpy()


def test_normalize_is_the_inverse_of_denormalize() -> None:
    rng = np.random.default_rng(3)
    frame = normalization_of(rng.normal(size=(50, 3)) + 7, 20 * rng.normal(size=(40, 3)) - 100)
    T = random_pose()
    np.testing.assert_allclose(frame.normalize(frame.denormalize(T)), T, atol=1e-12)


@pytest.mark.parametrize("offset", [0.0, 1.0, 1e6])
@pytest.mark.parametrize("length", [1e-3, 1.0, 1e3])
def test_a_pose_moves_the_same_points(offset: float, length: float) -> None:
    frame, T_normalized = random_frame(offset, length), random_pose()
    T = frame.denormalize(T_normalized)
    x = frame.source_center + length * RNG.normal(size=(20, 3))
    y_normalized = (x - frame.source_center) / length @ T_normalized[:3, :3].T + T_normalized[:3, 3]
    np.testing.assert_allclose(
        x @ T[:3, :3].T + T[:3, 3],
        length * y_normalized + frame.target_center,
        atol=1e-9 * max(length, offset),
    )


@pytest.mark.parametrize(("offset", "length"), [(0.0, 1.0), (1.0, 2.5), (40.0, 0.3)])
def test_the_covariance_transforms_as_finite_differences_say(offset: float, length: float) -> None:
    frame, T_normalized = random_frame(offset, length), random_pose()
    T = frame.denormalize(T_normalized)
    step, jacobian = 1e-6, np.zeros((6, 6))
    for i in range(6):
        twists = []
        for sign in (1.0, -1.0):
            xi = torch.zeros(6, dtype=torch.float64)
            xi[i] = sign * step
            perturbed = frame.denormalize(T_normalized @ rigid.exp_se3(xi).numpy())
            # The right perturbation, in the input's frames, that has the same effect.
            twists.append(rigid.log_se3(torch.from_numpy(np.linalg.inv(T) @ perturbed)).numpy())
        jacobian[:, i] = (twists[0] - twists[1]) / (2 * step)
    root = RNG.normal(size=(6, 6))
    covariance = root @ root.T
    expected = jacobian @ covariance @ jacobian.T
    np.testing.assert_allclose(
        frame.denormalize_covariance(covariance), expected, atol=1e-6 * np.abs(expected).max()
    )


def test_a_few_stray_points_do_not_shrink_the_rest() -> None:
    cloud = RNG.normal(size=(1000, 3))
    stray = np.vstack([cloud, [[1e4, 0, 0]] * 5])
    clean, dirty = (normalization_of(x, cloud).length for x in (cloud, stray))
    assert 0.5 < dirty / clean < 60.0  # the mean moves by the stray points, the radius with it
    assert normalization_of(stray, cloud).source_center[0] < 60.0


def test_a_heap_of_copies_still_has_a_length() -> None:
    heap = np.vstack([np.zeros((1000, 3)), np.eye(3)])
    assert 0.5 < normalization_of(heap, heap).length < 1.5


def test_the_length_is_that_of_the_larger_cloud_and_other_units_are_noted() -> None:
    cloud = RNG.normal(size=(100, 3))
    for pair in ((cloud, cloud * 1000), (cloud * 1000, cloud)):
        frame = normalization_of(*pair)
        assert 1000 < frame.length < 6000
        assert "is the unit the same?" in frame.notes[0]
    assert normalization_of(cloud, cloud * 3).notes == ()


def test_the_center_is_exact_far_from_the_origin() -> None:
    cloud = RNG.normal(size=(1000, 3))
    center = normalization_of(cloud + 1e6, cloud).source_center
    np.testing.assert_allclose(center - 1e6, cloud.mean(axis=0), atol=1e-9)


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_normalized_clouds_come_back_as_they_were(offset: float) -> None:
    source, target = RNG.normal(size=(50, 3)) + offset, 3.0 * RNG.normal(size=(70, 3)) - offset
    eye = np.array([9.0, 8.0, 7.0]) + offset
    source_seen, target_seen, frame = normalized_clouds(source, target, eye)
    assert frame.length == normalization_of(source, target).length
    for seen, given, center in (
        (source_seen, source, frame.source_center),
        (target_seen, target, frame.target_center),
    ):
        assert seen.points.dtype == torch.float64
        assert float(seen.points.mean(0).abs().max()) < 1e-9
        back = seen.points.numpy() * frame.length + center
        np.testing.assert_allclose(back, given, rtol=0, atol=1e-8)
    assert source_seen.viewpoint is not None
    np.testing.assert_allclose(
        source_seen.viewpoint.numpy() * frame.length + frame.source_center, eye, atol=1e-8
    )
    assert target_seen.viewpoint is None


@pytest.mark.parametrize("far", [15.0, 1e6])
def test_stray_points_neither_move_the_center_nor_hide(far: float) -> None:
    points = np.random.default_rng(2).normal(loc=3.0, size=(2000, 3))
    stray = np.vstack([points, [[0, 0, far * 3.0]]])
    center, radius = center_and_radius(stray)
    np.testing.assert_allclose(center, points.mean(axis=0), atol=1e-9)
    assert radius == pytest.approx(center_and_radius(points)[1], rel=1e-3)
    (note,) = normalization_of(stray, points).notes
    assert note.startswith("source: 1 point lies far from the rest, up to ")
    assert note.endswith("radii: a stray return?")
    assert normalization_of(points, points).notes == ()
