"""The diameter, against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from fullturn.geometry.diameter import diameter


def test_the_diameter_is_the_largest_distance() -> None:
    points = np.random.default_rng(3).normal(size=(300, 3))
    brute = np.linalg.norm(points[:, None] - points[None], axis=2).max()
    assert diameter(points) == pytest.approx(brute)
    flat = points * (1, 1, 0)
    brute = np.linalg.norm(flat[:, None] - flat[None], axis=2).max()
    assert diameter(flat) == pytest.approx(brute)
