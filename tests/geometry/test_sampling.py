"""Thinning: exactness against a plain loop, order independence, spacing."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from fullturn.errors import InputError
from fullturn.geometry import sampling
from fullturn.geometry.sampling import (
    farthest_point_sample,
    local_area,
    point_spacing,
    voxel_sample,
)


def cloud(n: int = 300, *, seed: int = 0) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).standard_normal((n, 3)))


def farthest_by_definition(points: np.ndarray, count: int, start: int) -> list[int]:
    chosen = [start]
    while len(chosen) < count:
        gaps = np.linalg.norm(points[:, None] - points[chosen], axis=-1).min(axis=1)
        gaps[chosen] = -1
        chosen.append(int(gaps.argmax()))
    return chosen


FARTHEST = {
    "numpy": farthest_point_sample,
    "torch": lambda points, count, *, start=0: sampling._farthest_torch(points, count, start),
}


@pytest.mark.parametrize("sample", FARTHEST.values(), ids=FARTHEST)
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_farthest_points_are_exact(offset: float, sample) -> None:
    points = cloud(120) + offset
    assert sample(points, 40, start=7).tolist() == farthest_by_definition(points.numpy(), 40, 7)


@pytest.mark.parametrize("sample", FARTHEST.values(), ids=FARTHEST)
def test_farthest_points_survive_a_far_outlier(sample) -> None:
    points = torch.cat([cloud(80), torch.full((1, 3), 1e9, dtype=torch.float64)])
    assert sample(points, 30).tolist() == farthest_by_definition(points.numpy(), 30, 0)


@pytest.mark.parametrize("sample", FARTHEST.values(), ids=FARTHEST)
def test_duplicates_come_last_and_no_index_twice(sample) -> None:
    points = torch.cat([cloud(10), cloud(10)])
    index = sample(points, 20)
    assert sorted(index.tolist()) == list(range(20))
    assert len(torch.unique(points[index[:10]], dim=0)) == 10


@pytest.mark.parametrize("sample", FARTHEST.values(), ids=FARTHEST)
def test_counts_at_the_limits(sample) -> None:
    points = cloud(4)
    assert sample(points, 0).tolist() == []
    assert sample(points, 1, start=2).tolist() == [2]
    assert sorted(sample(points, 4).tolist()) == [0, 1, 2, 3]


def test_impossible_samples_are_named() -> None:
    with pytest.raises(InputError, match="number of points, 4, got 5"):
        farthest_point_sample(cloud(4), 5)
    with pytest.raises(InputError, match="start must be an index into 4 points, got 4"):
        farthest_point_sample(cloud(4), 2, start=4)


def test_voxel_means_by_definition() -> None:
    points = cloud(500)
    means, index = voxel_sample(points, 0.7)
    cells = np.floor((points - points.amin(0)).numpy() / 0.7).astype(int)
    expected = {}
    for cell in sorted(set(map(tuple, cells))):
        members = np.flatnonzero((cells == cell).all(axis=1))
        expected[cell] = (points[members].mean(0).numpy(), members)
    assert len(means) == len(index) == len(expected)
    for mean, i, (expected_mean, members) in zip(
        means.numpy(), index.tolist(), expected.values(), strict=True
    ):
        np.testing.assert_allclose(mean, expected_mean, rtol=0, atol=1e-14)
        assert i in members
        gaps = np.linalg.norm(points[members].numpy() - expected_mean, axis=1)
        assert np.linalg.norm(points[i].numpy() - expected_mean) <= gaps.min() + 1e-9


@pytest.mark.parametrize("voxel_size", [0.05, 0.4, 100.0])
def test_voxels_do_not_depend_on_the_order(voxel_size: float) -> None:
    points = cloud(2000)
    order = torch.from_numpy(np.random.default_rng(1).permutation(len(points)))
    means, index = voxel_sample(points, voxel_size)
    shuffled_means, shuffled_index = voxel_sample(points[order], voxel_size)
    torch.testing.assert_close(shuffled_means, means, rtol=0, atol=1e-13)
    assert torch.equal(order[shuffled_index], index)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_voxels_scale_with_the_cloud(dtype: torch.dtype) -> None:
    points = cloud(1000).to(dtype)
    _, index = voxel_sample(points, 0.5)
    for scale in (2.0**-10, 2.0**10):
        means, scaled_index = voxel_sample(points * scale, 0.5 * scale)
        assert means.dtype == dtype
        assert torch.equal(scaled_index, index)


def test_voxels_finer_than_any_integer_grid() -> None:
    points = torch.cat([cloud(50), cloud(50), torch.full((1, 3), 1e12, dtype=torch.float64)])
    means, index = voxel_sample(points, 1e-6)
    assert len(means) == 51
    torch.testing.assert_close(means, points[index], rtol=0, atol=0)


def test_voxels_of_degenerate_clouds() -> None:
    means, index = voxel_sample(torch.zeros(5, 3), 1.0)
    assert means.tolist() == [[0, 0, 0]]
    assert index.tolist() == [0]
    means, index = voxel_sample(torch.zeros(0, 3), 1.0)
    assert means.shape == (0, 3)
    assert index.shape == (0,)
    with pytest.raises(InputError, match="voxel_size must be positive"):
        voxel_sample(torch.zeros(5, 3), 0.0)


def test_voxels_leave_their_input_alone() -> None:
    points = cloud(100)
    before = points.clone()
    voxel_sample(points, 0.5)
    assert torch.equal(points, before)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_spacing_of_a_grid(scale: float, offset: float) -> None:
    axis = torch.arange(6, dtype=torch.float64)
    grid = torch.cartesian_prod(axis, axis, axis) * scale + offset
    assert point_spacing(grid) == pytest.approx(scale, rel=1e-6)


def test_spacing_skips_duplicates() -> None:
    points = cloud(300)
    assert point_spacing(points.repeat(6, 1)) == pytest.approx(point_spacing(points), rel=1e-12)


def test_spacing_of_a_large_cloud_needs_few_queries() -> None:
    points = cloud(20_000)
    _, distance = sampling.NeighborIndex(points).knn(points, 2)
    assert point_spacing(points) == pytest.approx(float(distance[:, 1].median()), rel=0.05)


@pytest.mark.parametrize("points", [torch.zeros(1, 3), torch.zeros(9, 3)])
def test_spacing_needs_two_distinct_points(points: torch.Tensor) -> None:
    with pytest.raises(InputError, match="two distinct points"):
        point_spacing(points)


def test_local_area_follows_density_and_no_motion_or_scale_changes_it() -> None:
    rng = np.random.default_rng(2)
    points = torch.from_numpy(rng.uniform(0, 1, (5000, 3))) * torch.tensor([1.0, 1.0, 0.0])
    dense = torch.arange(5000) < 4000
    points[dense, 0] -= 1
    area = local_area(points)
    assert float(area.mean()) == pytest.approx(1.0, rel=1e-12)
    # Away from the rim and from the seam, where the neighbors lie on all sides.
    x, y = points[:, 0], points[:, 1]
    inside = (x.abs() > 0.15) & (x.abs() < 0.85) & (y > 0.15) & (y < 0.85)
    ratio = area[inside & dense].mean() / area[inside & ~dense].mean()
    assert float(ratio) == pytest.approx(0.25, rel=0.1)
    turn = torch.from_numpy(Rotation.random(random_state=3).as_matrix())
    for scale in (1e-3, 1.0, 1e3):
        moved = (points @ turn.T + 2.0) * scale
        torch.testing.assert_close(local_area(moved), area, rtol=1e-9, atol=0)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_local_area_by_definition(scale: float) -> None:
    points = cloud(400) * scale
    reach = np.sort(torch.cdist(points, points).numpy(), axis=1)[:, 15] ** 2
    expected = np.clip(reach / np.quantile(reach, 0.5, method="lower"), 0.1, 10.0)
    assert (expected == 10.0).any()
    np.testing.assert_allclose(local_area(points).numpy(), expected / expected.mean(), rtol=1e-6)


@pytest.mark.parametrize("points", [cloud(0), cloud(1), cloud(2), torch.zeros(5, 3).double()])
def test_local_area_of_few_or_equal_points_is_even(points: torch.Tensor) -> None:
    torch.testing.assert_close(local_area(points), torch.ones(len(points)).double())
