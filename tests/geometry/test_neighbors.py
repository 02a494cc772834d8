"""Neighbors: the k-d tree and the brute-force path, each against SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from fullturn.errors import InputError
from fullturn.geometry import neighbors
from fullturn.geometry.neighbors import (
    NearestTracker,
    NeighborIndex,
    gather,
    knn,
    radius_neighbors,
)


def cloud(name: str, n: int = 200) -> torch.Tensor:
    points = np.random.default_rng(0).standard_normal((n, 3))
    if name == "planar":
        points[:, 2] = 0
    if name == "collinear":
        points[:, 1:] = 0
    if name == "millimeters":
        points *= 1e-3
    if name == "kilometers":
        points *= 1e3
    if name == "far":
        points += 1e6
    if name == "four":
        points = points[:4]
    return torch.from_numpy(points)


CLOUDS = ["generic", "planar", "collinear", "millimeters", "kilometers", "far", "four"]
SEARCHES = {"tree": knn, "brute force": neighbors._knn_torch}


@pytest.mark.parametrize("search", SEARCHES.values(), ids=SEARCHES)
@pytest.mark.parametrize("name", CLOUDS)
def test_knn_agrees_with_scipy(name: str, search) -> None:
    points = cloud(name)
    k = min(10, len(points))
    index, distance = search(points, points, k)
    expected_distance, expected_index = cKDTree(points.numpy()).query(points.numpy(), k)
    np.testing.assert_array_equal(index.numpy(), expected_index)
    np.testing.assert_allclose(distance.numpy(), expected_distance, rtol=1e-9, atol=1e-9)
    assert (distance[:, 0] == 0).all()
    assert (distance.diff(dim=-1) >= 0).all()


@pytest.mark.parametrize("search", SEARCHES.values(), ids=SEARCHES)
def test_float32_far_from_the_origin_is_exact_for_what_was_stored(search) -> None:
    points = (cloud("generic") + 1e4).float()
    index, distance = search(points, points, 5)
    assert distance.dtype == torch.float32
    expected_distance, _ = cKDTree(points.double().numpy()).query(points.double().numpy(), 5)
    np.testing.assert_allclose(distance.numpy(), expected_distance, rtol=1e-5, atol=1e-6)
    assert (index[:, 0] == torch.arange(len(points))).all()


@pytest.mark.parametrize("search", SEARCHES.values(), ids=SEARCHES)
def test_fewer_points_than_neighbors_are_padded(search) -> None:
    points = cloud("four")
    index, distance = search(points, points, 6)
    assert (index[:, :4] >= 0).all()
    assert (index[:, 4:] == -1).all()
    assert torch.isinf(distance[:, 4:]).all()
    assert torch.isfinite(distance[:, :4]).all()


@pytest.mark.parametrize("search", SEARCHES.values(), ids=SEARCHES)
def test_duplicates_are_found_and_repeatable(search) -> None:
    points = torch.cat([torch.zeros(60, 3), torch.ones(1, 3)])
    first, second = search(points, points, 5), search(points, points, 5)
    assert torch.equal(first[0], second[0])
    assert (first[1][:60] == 0).all()
    assert (first[0].sort(dim=-1).values.diff(dim=-1) > 0).all()


@pytest.mark.parametrize("search", SEARCHES.values(), ids=SEARCHES)
def test_a_batch_equals_the_loop_over_its_items(search) -> None:
    rng = np.random.default_rng(1)
    queries = torch.from_numpy(rng.standard_normal((2, 3, 5, 3)))
    points = torch.from_numpy(rng.standard_normal((2, 3, 40, 3)))
    index, distance = search(queries, points, 4)
    assert index.shape == distance.shape == (2, 3, 5, 4)
    for i in range(2):
        for j in range(3):
            expected = knn(queries[i, j], points[i, j], 4)
            assert torch.equal(index[i, j], expected[0])
            torch.testing.assert_close(distance[i, j], expected[1])


def test_chunks_do_not_change_the_result(monkeypatch: pytest.MonkeyPatch) -> None:
    points = cloud("generic")
    whole = neighbors._knn_torch(points, points, 7)
    monkeypatch.setattr(neighbors, "_MAX_DISTANCES_AT_ONCE", 1000)
    parts = neighbors._knn_torch(points, points, 7)
    assert torch.equal(whole[0], parts[0])
    torch.testing.assert_close(whole[1], parts[1])


def test_radius_keeps_the_nearest_within_it() -> None:
    points = cloud("generic")
    index, distance = radius_neighbors(points, points, 0.5, max_neighbors=8)
    tree = cKDTree(points.numpy())
    for i, inside in enumerate(tree.query_ball_point(points.numpy(), 0.5)):
        found = index[i][index[i] >= 0].tolist()
        assert len(found) == min(8, len(inside))
        assert set(found) <= set(inside)
    assert torch.equal(index < 0, torch.isinf(distance))
    assert (distance[index >= 0] <= 0.5).all()


def test_neighbor_index_gives_what_the_functions_give() -> None:
    points, queries = cloud("generic"), cloud("kilometers")[:9] / 500
    tree = NeighborIndex(points)
    for ours, expected in zip(tree.knn(queries, 3), knn(queries, points, 3), strict=True):
        assert torch.equal(ours, expected)
    index, distance = tree.nearest(queries)
    assert torch.equal(index, tree.knn(queries, 1)[0][:, 0])
    assert torch.equal(distance, tree.knn(queries, 1)[1][:, 0])


def test_no_queries_give_no_rows() -> None:
    index, distance = knn(torch.zeros(0, 3), torch.zeros(4, 3), 2)
    assert index.shape == distance.shape == (0, 2)


def test_results_are_detached_and_inputs_untouched() -> None:
    points = cloud("generic").requires_grad_()
    before = points.detach().clone()
    index, distance = knn(points, points, 3)
    assert not index.requires_grad
    assert not distance.requires_grad
    assert torch.equal(points.detach(), before)


def test_gather_takes_rows_per_batch_item() -> None:
    values = torch.arange(2 * 5 * 2, dtype=torch.float32).view(2, 5, 2)
    index = torch.tensor([[[0, 4], [2, -1]], [[1, 1], [3, 0]]])
    rows = gather(values, index)
    for b in range(2):
        assert torch.equal(rows[b], values[b][index[b].clamp_min(0)])


def test_fill_with_self() -> None:
    index = torch.tensor([[0, -1], [-1, 0]])
    assert neighbors.fill_with_self(index).tolist() == [[0, 0], [1, 0]]


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("points", "k", "message"),
    [
        (torch.zeros(0, 3), 1, "at least one point"),
        (torch.zeros(4, 2), 1, "3 columns"),
        (torch.zeros(4, 3), 0, "at least one neighbor"),
        (torch.full((4, 3), math.nan), 1, "must be finite"),
    ],
)
def test_bad_input_is_named(points: torch.Tensor, k: int, message: str) -> None:
    with pytest.raises(InputError, match=message):
        knn(torch.zeros(1, 3), points, k)


def test_bad_radius_is_named() -> None:
    with pytest.raises(InputError, match="radius must be positive, got 0"):
        radius_neighbors(torch.zeros(1, 3), torch.zeros(1, 3), 0.0, max_neighbors=1)


@pytest.mark.parametrize("within", [0.02, 0.3, 5.0])
@pytest.mark.parametrize("step", [1e-4, 0.02, 0.5])
def test_a_tracker_finds_what_a_search_finds(within: float, step: float) -> None:
    rng = np.random.default_rng(4)
    index = NeighborIndex(torch.from_numpy(rng.normal(size=(400, 3))))
    queries = rng.normal(size=(300, 3)) * rng.choice([0.5, 3.0], size=(300, 1))
    tracker = NearestTracker(index)
    for reach in (within, 0.7 * within, 0.7 * within, 1.5 * within, within):
        found = tracker.nearest(queries, within=reach)
        expected, _ = index.nearest(torch.from_numpy(queries), within=reach)
        near = expected.numpy() >= 0
        np.testing.assert_array_equal(found[near], expected.numpy()[near])
        distance = np.linalg.norm(queries - index.points.numpy()[found], axis=1)
        assert (distance[~near] > reach).all()
        queries = queries + step * rng.normal(size=queries.shape)


def test_a_tracker_searches_only_for_what_has_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    index = NeighborIndex(torch.from_numpy(rng.normal(size=(400, 3))))
    queries = rng.normal(size=(300, 3))
    tracker = NearestTracker(index)
    tracker.nearest(queries, within=0.5)
    asked: list[int] = []
    search = index.knn

    def counted(at: torch.Tensor, k: int, **reach: float) -> tuple[torch.Tensor, torch.Tensor]:
        asked.append(len(at))
        return search(at, k, **reach)

    monkeypatch.setattr(index, "knn", counted)
    queries[:7] = rng.normal(size=(7, 3))
    tracker.nearest(queries + 1e-9, within=0.5)
    assert asked == [7]


def test_a_tracker_of_one_point() -> None:
    tracker = NearestTracker(NeighborIndex(torch.zeros(1, 3).double()))
    queries = np.array([[0.1, 0, 0], [3.0, 0, 0]])
    for shift in (0.0, -2.5, 0.0):
        found = tracker.nearest(queries + np.array([shift, 0, 0]), within=1.0)
        near = np.abs(queries[:, 0] + shift) <= 1.0
        assert (found[near] == 0).all()


@pytest.mark.parametrize("within", [0.05, 0.5, 2.0])
def test_a_reach_leaves_out_what_lies_beyond(within: float) -> None:
    rng = np.random.default_rng(6)
    points, queries = (torch.from_numpy(rng.normal(size=(n, 3))) for n in (500, 200))
    queries[::3] *= 20
    index = NeighborIndex(points)
    found, distance = index.knn(queries, 3, within=within)
    expected, length = index.knn(queries, 3)
    near = length <= within
    assert bool((found == torch.where(near, expected, -1)).all())
    torch.testing.assert_close(distance, torch.where(near, length, torch.inf))
