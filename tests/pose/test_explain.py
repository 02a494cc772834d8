"""Matches and overlap against brute force."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from pose_shapes import random_motions, teapot
from scipy.spatial import cKDTree
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.geometry.cloud import Cloud
from fullturn.pose.explain import explain, partner_radius, pose_overlap

T_TRUE = random_motions(1, seed=2)[0]


def clouds(*, noise: float = 0.0, n: int = 900, m: int = 600) -> tuple[Cloud, Cloud]:
    rng = np.random.default_rng(0)
    source, target = teapot(n, 1)[0], teapot(m, 2)[0]
    source = source[source[:, 1] > -0.1]
    source = source + noise * torch.from_numpy(rng.normal(size=source.shape))
    return Cloud(source), Cloud(rigid.apply(T_TRUE, target))


def distances(source: Cloud, target: Cloud, T: Tensor) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each source point's distance and partner, and each target point's distance."""
    moved = rigid.apply(T, source.points).numpy()
    there, partner = cKDTree(target.points.numpy()).query(moved)
    back, _ = cKDTree(moved).query(target.points.numpy())
    return there, partner, back


def test_matches_and_overlap_by_hand() -> None:
    source, target = clouds()
    radius = partner_radius(source, target, T_TRUE)
    found = explain(source, target, T_TRUE)
    there, partner, back = distances(source, target, T_TRUE)
    near = there < radius
    np.testing.assert_array_equal(
        found.matches, np.column_stack([np.flatnonzero(near), partner[near]])
    )
    np.testing.assert_allclose(
        found.match_weights, (1 - (there[near] / radius) ** 2) ** 2, atol=1e-9
    )
    assert found.matches.dtype == np.int64
    assert found.overlap == pytest.approx((near.mean(), (back < radius).mean()))
    assert found.overlap == pose_overlap(source, target, T_TRUE)
    assert found.covariance.shape == (6, 6)
    # The source is about half of the object, the target all of it.
    assert found.overlap[0] > 0.9
    assert 0.3 < found.overlap[1] < 0.8


def test_a_cloud_overlaps_with_itself_wholly() -> None:
    cloud = Cloud(teapot(500)[0])
    found = explain(cloud, cloud, torch.eye(4).double())
    assert found.overlap == (1.0, 1.0)
    np.testing.assert_array_equal(found.matches, np.repeat(np.arange(500)[:, None], 2, 1))
    np.testing.assert_allclose(found.match_weights, 1.0)


def test_the_radius_is_two_spacings_of_the_sparser_cloud_or_what_noise_asks() -> None:
    points = teapot(900, 1)[0]
    dense, sparse = Cloud(points), Cloud(rigid.apply(T_TRUE, points[::2]))
    assert partner_radius(dense, dense, torch.eye(4).double()) == 2 * dense.spacing
    inverse = rigid.invert(T_TRUE)
    assert partner_radius(sparse, dense, inverse) == pytest.approx(2 * sparse.spacing)
    source, target = clouds()
    largest = max(source.spacing, target.spacing)
    assert 2 * largest <= partner_radius(source, target, T_TRUE) < 3.5 * largest
    clean, noisy = (clouds(n=20_000, m=20_000, noise=noise) for noise in (0.0, 0.015))
    assert partner_radius(*noisy, T_TRUE) > 1.3 * partner_radius(*clean, T_TRUE)
    assert pose_overlap(*noisy, T_TRUE)[0] > 0.85


def test_swapping_the_clouds_swaps_the_shares() -> None:
    source, target = clouds()
    radius = partner_radius(source, target, T_TRUE)
    there = pose_overlap(source, target, T_TRUE, radius=radius)
    back = pose_overlap(target, source, rigid.invert(T_TRUE), radius=radius)
    assert there == pytest.approx(back[::-1])


def test_nothing_in_common_is_no_match() -> None:
    source, target = clouds()
    away = rigid.make(torch.eye(3).double(), torch.tensor([9.0, 0, 0]).double())
    found = explain(source, target, away)
    assert found.overlap == (0.0, 0.0)
    assert found.matches.shape == (0, 2)
    assert found.matches.dtype == np.int64
    assert found.match_weights.shape == (0,)
    assert np.isfinite(found.covariance).all()


def test_large_clouds_are_sampled_for_the_shares_and_matched_whole() -> None:
    source, target = clouds(n=60_000, m=25_000)
    found = explain(source, target, T_TRUE)
    there, _, back = distances(source, target, T_TRUE)
    radius = partner_radius(source, target, T_TRUE)
    assert len(found.matches) == int((there < radius).sum())
    expected = ((there < radius).mean(), (back < radius).mean())
    assert found.overlap == pytest.approx(expected, abs=0.02)
