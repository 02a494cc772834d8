from __future__ import annotations

import numpy as np
import pytest

from fullturn.data import motion


def angle_deg(rotation: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))


@pytest.mark.parametrize(
    "draw",
    [
        motion.uniform_rotation,
        lambda rng: motion.axis_angle_rotation(rng, max_angle_deg=180.0),
        lambda rng: motion.euler_rotation(rng, max_angle_deg=180.0),
    ],
)
def test_rotations_are_rotations(draw) -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        rotation = draw(rng)
        assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_mean_angles_tell_the_distributions_apart() -> None:
    rng = np.random.default_rng(0)
    uniform = [angle_deg(motion.uniform_rotation(rng)) for _ in range(4000)]
    about_axis = [
        angle_deg(motion.axis_angle_rotation(rng, max_angle_deg=180.0)) for _ in range(4000)
    ]
    assert np.mean(uniform) == pytest.approx(126.5, abs=2.0)
    assert np.mean(about_axis) == pytest.approx(90.0, abs=3.0)


def test_euler_is_rx_ry_rz_with_angles_in_range() -> None:
    rotation = motion.euler_rotation(np.random.default_rng(3), max_angle_deg=45.0)
    z, y, x = np.deg2rad(np.random.default_rng(3).uniform(0.0, 45.0, 3))
    rx = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    ry = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    rz = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    assert np.allclose(rotation, rx @ ry @ rz)


def test_translation_lengths_fill_the_range() -> None:
    rng = np.random.default_rng(0)
    lengths = [np.linalg.norm(motion.ball_translation(rng, max_length=0.5)) for _ in range(2000)]
    assert max(lengths) <= 0.5
    assert np.mean(lengths) == pytest.approx(0.25, abs=0.01)
