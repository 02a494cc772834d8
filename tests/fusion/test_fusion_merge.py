"""The merged cloud: counts add up, a surface seen twice becomes one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fullturn.fusion.merge import merge_clouds


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_every_point_is_counted_once_and_the_mean_is_kept(scale: float) -> None:
    rng = np.random.default_rng(0)
    clouds = [scale * rng.uniform(size=(count, 3)) for count in (500, 1, 300)]
    merged = merge_clouds(clouds, 0.1 * scale)
    assert merged.count.sum() == 801
    weighted = (merged.points * merged.count[:, None]).sum(0) / 801
    np.testing.assert_allclose(weighted, np.concatenate(clouds).mean(0), rtol=1e-9)


def test_cells_are_those_of_a_plain_loop() -> None:
    rng = np.random.default_rng(1)
    clouds = [rng.uniform(-1, 1, size=(200, 3)) for _ in range(3)]
    cells: dict[tuple[int, ...], list[np.ndarray]] = {}
    for point in np.concatenate(clouds):
        cells.setdefault(tuple(int(x) for x in np.floor(point / 0.3)), []).append(point)
    merged = merge_clouds(clouds, 0.3)
    distance, _ = cKDTree(merged.points).query([np.mean(cell, axis=0) for cell in cells.values()])
    # A few neighbors are joined: those stand half a cell at most from their mean.
    assert (distance < 1e-12).mean() > 0.8
    assert distance.max() <= 0.15
    assert len(merged.points) <= len(cells)


def test_a_surface_seen_twice_becomes_one() -> None:
    rng = np.random.default_rng(2)
    sheets = [np.c_[rng.uniform(size=(20_000, 2)), 0.001 * rng.normal(size=20_000)] for _ in "ab"]
    merged = merge_clouds(sheets, 0.02)
    # Points are about a cell apart: no second layer under the first, though z = 0 parts two cells.
    gaps = cKDTree(merged.points).query(merged.points, k=2)[0][:, 1]
    assert len(merged.points) < 1.15 * 50 * 50
    assert np.quantile(gaps, 0.05) > 0.01
    assert abs(merged.points[:, 2]).max() < 0.004


def test_the_order_of_clouds_changes_nothing() -> None:
    rng = np.random.default_rng(3)
    clouds = [rng.normal(size=(300, 3)) for _ in range(3)]
    one, other = (merge_clouds(c, 0.5) for c in (clouds, clouds[::-1]))
    np.testing.assert_allclose(one.points, other.points, atol=1e-12)
    np.testing.assert_array_equal(one.count, other.count)


@pytest.mark.parametrize("far", [1e18, 1e30, 1e100])
def test_stray_points_stay_as_they_are(far: float) -> None:
    rng = np.random.default_rng(4)
    near, strays = rng.normal(size=(300, 3)), far * np.array([[1.0, 0, 0], [3.0, 0, 0]])
    merged, alone = merge_clouds([near, strays], 0.5), merge_clouds([near], 0.5)
    order = np.argsort(np.linalg.norm(merged.points, axis=1))
    np.testing.assert_array_equal(merged.points[order[-2:]], strays)
    np.testing.assert_array_equal(np.delete(merged.points, order[-2:], axis=0), alone.points)
