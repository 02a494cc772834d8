from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fullturn.geometry.motion import (
    adjoint,
    invert,
    move,
    nearest_rotation,
    rigid,
    rotation_angle_deg,
    skew,
    small_motion,
)


def test_inverses_undo_the_motions() -> None:
    rng = np.random.default_rng(0)
    R = Rotation.random(3, random_state=0).as_matrix()
    T = np.stack([rigid(turn, rng.normal(size=3)) for turn in R])
    points = rng.normal(size=(7, 3))
    for motion, inverse in zip(T, invert(T), strict=True):
        assert np.allclose(move(inverse, move(motion, points)), points)
        assert np.allclose(inverse, np.linalg.inv(motion))
        assert np.array_equal(inverse, invert(motion))


@pytest.mark.parametrize("angle_deg", [0.0, 1e-6, 30.0, 179.999999, 180.0])
def test_the_angle_that_is_shown(angle_deg: float) -> None:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(np.radians(angle_deg) * np.array([0.6, 0, 0.8])).as_matrix()
    assert rotation_angle_deg(T[:3, :3]) == pytest.approx(angle_deg, abs=1e-9)


def test_the_nearest_rotation_is_one_even_to_a_mirror() -> None:
    rng = np.random.default_rng(1)
    R = Rotation.random(random_state=1).as_matrix()
    np.testing.assert_allclose(nearest_rotation(R + 1e-9 * rng.normal(size=(3, 3))), R, atol=1e-8)
    mirrored = nearest_rotation(R @ np.diag([1.0, 1.0, -0.5]))
    assert np.linalg.det(mirrored) == pytest.approx(1.0)


BATCHES = pytest.mark.parametrize("batch", [(), (4,), (2, 3)])


@BATCHES
def test_skew_is_the_cross_product(batch: tuple[int, ...]) -> None:
    v, x = np.random.default_rng(2).normal(size=(2, *batch, 3))
    np.testing.assert_allclose((skew(v) @ x[..., None])[..., 0], np.cross(v, x))


@BATCHES
def test_small_motions_turn_by_their_step_to_the_third_order(batch: tuple[int, ...]) -> None:
    step = np.random.default_rng(6).normal(scale=0.1, size=(*batch, 6))
    T = small_motion(step)
    R, turn = T[..., :3, :3], step[..., :3]
    back = np.swapaxes(R, -1, -2)
    np.testing.assert_allclose(R @ back, np.broadcast_to(np.eye(3), R.shape), atol=1e-14)
    angle = np.linalg.norm(turn, axis=-1)
    np.testing.assert_allclose(np.radians(rotation_angle_deg(R)), 2 * np.arctan(angle / 2))
    exact = Rotation.from_rotvec(turn.reshape(-1, 3)).as_matrix().reshape(R.shape)
    assert (np.radians(rotation_angle_deg(back @ exact)) < angle**3 / 12).all()
    np.testing.assert_array_equal(T[..., :3, 3], step[..., 3:])
    np.testing.assert_array_equal(small_motion(0 * step), np.broadcast_to(np.eye(4), T.shape))


@BATCHES
def test_the_adjoint_takes_small_motions_to_another_frame(batch: tuple[int, ...]) -> None:
    rng = np.random.default_rng(7)
    R = Rotation.random(max(1, math.prod(batch)), random_state=7).as_matrix().reshape(*batch, 3, 3)
    T_a_b = rigid(R, rng.normal(size=(*batch, 3)))
    step = 1e-6 * rng.normal(size=(*batch, 6))
    there = (adjoint(T_a_b) @ step[..., None])[..., 0]
    expected = T_a_b @ small_motion(step) @ invert(T_a_b)
    np.testing.assert_allclose(small_motion(there), expected, atol=1e-11)
