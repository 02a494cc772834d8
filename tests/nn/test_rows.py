"""Clouds end to end: nothing leaks from one to the next, and nothing is lost on the way."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from nn_reference import cloud

from fullturn.geometry.sampling import farthest_point_sample
from fullturn.nn.clouds import CloudBatch
from fullturn.nn.rows import Rows, _farthest_together, farthest_rows, nearest_rows, pack, unpack

SIZES = [(7, 7), (7,), (9, 2, 30)]


def rows(sizes: tuple[int, ...]) -> Rows:
    clouds = [cloud(n, seed=i) for i, n in enumerate(sizes)]
    return Rows(torch.cat(clouds), sizes)


@pytest.mark.parametrize("sizes", SIZES)
def test_unpack_undoes_pack(sizes: tuple[int, ...]) -> None:
    batch = CloudBatch.collate(rows(sizes).each())
    packed = pack(batch.points, batch.mask)
    assert torch.equal(packed, rows(sizes).points)
    back = unpack(packed, batch.mask)
    assert torch.equal(back[batch.mask], packed)
    assert (back[~batch.mask] == 0).all()


def test_a_mask_may_have_holes() -> None:
    mask = torch.tensor([[False, True, False, True], [True, True, True, False]])
    values = torch.arange(16.0).view(2, 4, 2)
    assert torch.equal(pack(values, mask), values.flatten(0, 1)[[1, 3, 4, 5, 6]])
    assert torch.equal(unpack(pack(values, mask), mask), values * mask[..., None])


@pytest.mark.parametrize("sizes", SIZES)
def test_each_cloud_is_centered(sizes: tuple[int, ...]) -> None:
    for centered, posed in zip(rows(sizes).centered().each(), rows(sizes).each(), strict=True):
        torch.testing.assert_close(centered.mean(0), torch.zeros(3).double(), atol=1e-15, rtol=0)
        torch.testing.assert_close(centered, posed - posed.mean(0))


@pytest.mark.parametrize("k", [1, 5, 12])
@pytest.mark.parametrize("sizes", SIZES)
def test_neighbors_come_from_the_same_cloud(sizes: tuple[int, ...], k: int) -> None:
    points = rows(sizes)
    queries = Rows(points.points + 0.01, sizes)
    index, distance = nearest_rows(queries, points, k)
    first = 0
    for n in sizes:
        for row in range(first, first + n):
            reach = (points.points[first : first + n] - queries.points[row]).norm(dim=-1)
            order = reach.argsort()[:k]
            found = len(order)
            assert index[row, :found].tolist() == (order + first).tolist()
            torch.testing.assert_close(distance[row, :found], reach[order])
            assert (index[row, found:] == -1).all()
            assert torch.isinf(distance[row, found:]).all()
        first += n


@pytest.mark.parametrize("sizes", SIZES)
def test_farthest_points_of_each_cloud(sizes: tuple[int, ...]) -> None:
    points = rows(sizes)
    counts = [max(1, n // 2) for n in sizes]
    chosen = farthest_rows(points, counts).split(counts)
    together = _farthest_together(points, counts)
    first = 0
    for item, each in enumerate(points.each()):
        expected = farthest_point_sample(each, counts[item])
        assert torch.equal(chosen[item], expected + first)
        assert torch.equal(together[item], expected)
        first += len(each)


def test_farthest_points_of_duplicates_are_distinct() -> None:
    clouds = [torch.zeros(4, 3), torch.from_numpy(np.random.default_rng(0).random((9, 3))).float()]
    points = Rows(torch.cat(clouds), (4, 9))
    for chosen in _farthest_together(points, [4, 9]):
        assert sorted(chosen.tolist()) == list(range(len(chosen)))
