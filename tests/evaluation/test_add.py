"""ADD and ADD-S, against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fullturn.evaluation.metrics import add, add_s


def random_pose(rng: np.random.Generator) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
    T[:3, 3] = rng.normal(size=3)
    return T


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_add_s_is_brute_force_and_never_above_add(offset: float) -> None:
    rng = np.random.default_rng(0)
    model = rng.normal(size=(80, 3))
    for _ in range(5):
        found, true = random_pose(rng), random_pose(rng)
        found[:3, 3] += offset
        true[:3, 3] += offset
        at, to = (model @ T[:3, :3].T + T[:3, 3] for T in (true, found))
        brute = np.linalg.norm(at[:, None] - to[None], axis=2).min(1).mean()
        assert add_s(found, true, model) == pytest.approx(brute, rel=1e-6)
        assert add_s(found, true, model) <= add(found, true, model)


def test_the_true_pose_has_no_error() -> None:
    model = np.random.default_rng(1).normal(size=(50, 3))
    T = random_pose(np.random.default_rng(2))
    assert add(T, T, model) == 0.0
    assert add_s(T, T, model) == pytest.approx(0.0, abs=1e-12)


def test_add_s_forgives_the_turn_of_a_symmetric_model() -> None:
    square = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    assert add(turned, np.eye(4), square) == pytest.approx(2.0)
    assert add_s(turned, np.eye(4), square) == pytest.approx(0.0, abs=1e-12)
