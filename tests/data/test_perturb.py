from __future__ import annotations

import numpy as np
import pytest

from fullturn.data.perturb import crop_nearest, crop_plane, far_viewpoint, jitter, resample
from fullturn.errors import InputError


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(1000, 3))


def test_jitter_has_the_stated_sigma_and_clip(points: np.ndarray) -> None:
    big = np.zeros((100_000, 3))
    noise = jitter(big, np.random.default_rng(0), sigma=0.01, clip=0.05)
    assert noise.std() == pytest.approx(0.01, rel=0.01)
    clipped = jitter(big, np.random.default_rng(0), sigma=0.01, clip=0.005)
    assert np.abs(clipped).max() == 0.005


def test_far_viewpoint_lies_on_either_side_of_the_diagonal() -> None:
    drawn = np.array([far_viewpoint(np.random.default_rng(i)) for i in range(400)])
    sign = np.sign(drawn[:, 0])
    corner = drawn - 500.0 * sign[:, None]
    assert corner.min() >= 0.0
    assert corner.max() <= 1.0
    assert 0.4 < np.mean(sign > 0) < 0.6


def test_crop_nearest_keeps_the_nearest(points: np.ndarray) -> None:
    viewpoint = np.array([500.3, 500.1, 500.9])
    kept = crop_nearest(points, viewpoint, keep=750)
    distance = np.linalg.norm(points - viewpoint, axis=1)
    expected = points[distance <= np.sort(distance)[749]]
    assert np.array_equal(kept, expected)


def test_crop_plane_leaves_one_side(points: np.ndarray) -> None:
    kept = crop_plane(points, np.random.default_rng(5), keep_share=0.7)
    assert len(kept) == 700
    is_kept = (points[:, None] == kept[None]).all(axis=2).any(axis=1)
    # Linearly separable: the two sides' hulls do not meet, so a plane's heights do not overlap.
    normal = np.random.default_rng(5).normal(size=3)
    height = points @ normal
    assert height[is_kept].min() >= height[~is_kept].max()


def test_resample_draws_different_points(points: np.ndarray) -> None:
    drawn = resample(points, np.random.default_rng(0), count=400)
    assert len(np.unique(drawn, axis=0)) == 400
    assert {tuple(p) for p in drawn} <= {tuple(p) for p in points}


def test_too_few_points_are_named(points: np.ndarray) -> None:
    with pytest.raises(InputError, match="at least 2000 points, got 1000"):
        resample(points, np.random.default_rng(0), count=2000)
    with pytest.raises(InputError, match="at least 2000 points, got 1000"):
        crop_nearest(points, np.zeros(3), keep=2000)
    with pytest.raises(InputError, match="keep_share"):
        crop_plane(points, np.random.default_rng(0), keep_share=1.5)
