from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from fullturn.geometry import rigid as of_tensors
from fullturn.geometry.motion import (
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


def test_skew_is_the_cross_product() -> None:
    v, x = np.random.default_rng(2).normal(size=(2, 3))
    np.testing.assert_allclose(skew(v) @ x, np.cross(v, x))


@pytest.mark.parametrize("size", [0.0, 1e-9, 0.1, 2.0])
def test_small_motions_are_those_of_tensors(size: float) -> None:
    step = size * np.random.default_rng(2).normal(size=6)
    expected = of_tensors.small_motion(torch.from_numpy(step)).numpy()
    np.testing.assert_allclose(small_motion(step), expected, atol=1e-15)
