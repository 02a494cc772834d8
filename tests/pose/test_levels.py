"""Thinning keeps to its limit and to one spacing, whatever the size, density and order."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from pose_shapes import teapot
from scipy.spatial import cKDTree
from torch import Tensor

from fullturn.geometry.cloud import Cloud
from fullturn.geometry.neighbors import knn
from fullturn.geometry.sampling import local_area, point_spacing
from fullturn.pose.levels import LevelPair, level_pair, thin_pair, whole_pair


def shuffled(points: Tensor, seed: int = 0) -> Tensor:
    return points[torch.from_numpy(np.random.default_rng(seed).permutation(len(points)))]


def gap(points: Tensor, other: Tensor) -> float:
    """The largest distance from a point of one cloud to the nearest of the other."""
    return float(cKDTree(other.numpy()).query(points.numpy())[0].max())


@pytest.mark.parametrize("limit", [400, 800, 2048])
@pytest.mark.parametrize(("n", "m"), [(50, 200_000), (5_000, 3_000), (200_000, 200_000)])
def test_the_limit_holds_and_is_nearly_used(n: int, m: int, limit: int) -> None:
    thinned = thin_pair(teapot(n, 1)[0], teapot(m, 2)[0], limit=limit)
    counts = [len(points) for points in thinned]
    assert max(counts) <= limit
    assert max(counts) > 0.6 * limit


def test_small_clouds_are_kept_and_sorted() -> None:
    source, target = teapot(300, 1)[0], teapot(50, 2)[0]
    thinned = thin_pair(source, target, limit=300)
    for kept, points in zip(thinned, (source, target), strict=True):
        expected = points.numpy()[np.lexsort(points.numpy().T[::-1])]
        np.testing.assert_array_equal(kept.numpy(), expected)


def test_points_are_means_of_voxels_of_one_size() -> None:
    dense, sparse = teapot(20_000, 1)[0], teapot(1_500, 2)[0]
    thin_dense, thin_sparse = thin_pair(dense, sparse, limit=500)
    h = point_spacing(thin_dense)
    # Of one size, not of one count; and never farther from the cloud than a voxel is wide.
    assert point_spacing(thin_sparse) == pytest.approx(h, rel=0.25)
    assert gap(thin_dense, dense) < h
    assert gap(dense, thin_dense) < 3 * h
    assert gap(sparse, thin_sparse) < 3 * h


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_no_shift_changes_it_and_any_unit_works(scale: float) -> None:
    source, target = teapot(3_000, 1)[0], teapot(2_500, 2)[0]
    plain = thin_pair(source, target, limit=600)
    moved = thin_pair(source + 0.25, target - 0.5, limit=600)
    for one, other, offset in zip(plain, moved, (0.25, -0.5), strict=True):
        torch.testing.assert_close(one + offset, other, atol=1e-9, rtol=0)
    counts = [len(x) for x in thin_pair(source * scale, target * scale, limit=600)]
    assert 0.6 * 600 < max(counts) <= 600


@pytest.mark.parametrize("count", [300, 5_000, 30_000])
def test_the_order_of_points_is_nothing(count: int) -> None:
    source, target = teapot(count, 1)[0], teapot(count // 2, 2)[0]
    plain = thin_pair(source, target, limit=800)
    mixed = thin_pair(shuffled(source), shuffled(target), limit=800)
    for one, other in zip(plain, mixed, strict=True):
        torch.testing.assert_close(one, other, atol=1e-12, rtol=0)


def test_the_order_of_very_many_points_is_nothing() -> None:
    source, target = teapot(200_000, 1)[0], teapot(90_000, 2)[0]
    plain = thin_pair(source, target, limit=800)
    mixed = thin_pair(shuffled(source), shuffled(target), limit=800)
    for one, other in zip(plain, mixed, strict=True):
        assert len(one) == len(other)
        assert gap(one, other) < 1e-9


def test_equal_coordinates_do_not_undo_the_order() -> None:
    # Means of points of one plane differ by rounding: it must not decide which row comes first.
    rng = np.random.default_rng(3)
    plane = torch.from_numpy(rng.uniform(-1, 1, (20_000, 3)))
    plane[:, 0] = 1 / 3
    plain = thin_pair(plane, plane, limit=500)[0]
    mixed = thin_pair(shuffled(plane), plane, limit=500)[0]
    torch.testing.assert_close(plain, mixed, atol=1e-9, rtol=0)


@pytest.mark.parametrize("limit", [600, 800, 2048])
@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_lattices_keep_to_the_limit(dimensions: int, limit: int) -> None:
    side = {1: 9261, 2: 96, 3: 21}[dimensions]
    line = torch.linspace(-1, 1, side).double()
    axes = [line] * dimensions + [torch.zeros(1).double()] * (3 - dimensions)
    lattice = torch.cartesian_prod(*axes)
    thinned = thin_pair(lattice, lattice[::2], limit=limit)
    assert max(len(points) for points in thinned) <= limit


@pytest.mark.parametrize("distance", [10.0, 1e3, 1e6])
def test_far_outliers_leave_the_rest_as_fine(distance: float) -> None:
    source, target = teapot(4_000, 1)[0], teapot(3_000, 2)[0]
    stray = torch.tensor([[distance, 0, 0], [0, -distance, 0]]).double()
    thinned, _ = thin_pair(torch.cat([source, stray]), target, limit=800)
    assert 400 < len(thinned) <= 800


@pytest.mark.parametrize("limit", [400, 800])
def test_copies_count_once(limit: int) -> None:
    distinct = teapot(60, 1)[0]
    copies = shuffled(distinct.repeat(100, 1))
    thinned, other = thin_pair(copies, teapot(2_000, 2)[0], limit=limit)
    assert len(thinned) <= 60
    assert len(other) <= limit
    assert bool(torch.isfinite(thinned).all())


@pytest.mark.parametrize("size", [1e-3, 1e-6])
def test_a_cloud_smaller_than_a_voxel_keeps_some_points(size: float) -> None:
    small, large = thin_pair(teapot(3_000, 1)[0] * size, teapot(3_000, 2)[0], limit=800)
    assert len(large) <= 800
    assert len(small) >= 4
    level_pair(small, large, support=(Cloud(small), Cloud(large)))


def test_a_level_has_normals_and_the_coarser_spacing() -> None:
    source, normals = teapot(1_500, 1)
    target, _ = teapot(400, 2)
    pair = whole_pair(Cloud(source), Cloud(target))
    for level, points in ((pair.source, source), (pair.target, target)):
        rows = torch.from_numpy(np.lexsort(points.numpy().T[::-1]))
        assert level.points.dtype == level.normals.dtype == torch.float32
        torch.testing.assert_close(level.points, points[rows].float())
        torch.testing.assert_close(level.normals.norm(dim=1), torch.ones(len(points)))
        index, distance = knn(points[rows], points[rows], 20)
        torch.testing.assert_close(level.around, index)
        torch.testing.assert_close(level.area, local_area(points[rows], distance=distance).float())
        outwards = level.points - level.points.mean(0)
        assert float((level.normals * outwards).sum(1).min()) > -1e-6
    assert pair.spacing == pytest.approx(point_spacing(target))
    rows = torch.from_numpy(np.lexsort(source.numpy().T[::-1]))
    cosine = (pair.source.normals.double() * normals[rows]).sum(1).abs()
    assert float(cosine.median()) > 0.98


def test_support_sharpens_the_normals_of_a_thinned_cloud() -> None:
    fine, _ = teapot(6_000, 1)
    thinned, _ = thin_pair(fine, fine, limit=400)
    truth = teapot(6_000, 1)[1][torch.from_numpy(cKDTree(fine.numpy()).query(thinned.numpy())[1])]

    def agreement(pair: LevelPair) -> float:
        return float((pair.source.normals.double() * truth).sum(1).abs().mean())

    sharp = level_pair(thinned, thinned, support=(Cloud(fine), Cloud(fine)))
    blunt = whole_pair(Cloud(thinned), Cloud(thinned))
    assert agreement(sharp) > agreement(blunt)
    assert sharp.spacing == blunt.spacing == pytest.approx(point_spacing(thinned))


@pytest.mark.parametrize("count", [3, 4, 7])
def test_a_handful_of_points_makes_a_level(count: int) -> None:
    points, _ = teapot(count, 1)
    pair = whole_pair(Cloud(points), Cloud(points))
    assert len(pair.source.points) == count
    assert bool(torch.isfinite(pair.source.normals).all())
