"""The grid agrees with a k-d tree within its cells, and says "none" beyond its band."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from pose_shapes import teapot
from scipy.spatial import cKDTree
from torch import Tensor

from fullturn.pose.grid import NearestGrid

CELL, BAND = 0.03, 0.12
DIAGONAL = math.sqrt(3.0) * CELL


def grid_of(count: int, dtype: torch.dtype = torch.float64) -> tuple[Tensor, NearestGrid]:
    points, normals = (x.to(dtype) for x in teapot(count))
    return points, NearestGrid(points, normals, cell=CELL, band=BAND)


def queries(count: int, *, seed: int = 0, reach: float = 1.3) -> Tensor:
    """Coordinates first, as the grid takes them."""
    return torch.from_numpy(np.random.default_rng(seed).uniform(-reach, reach, (count, 3))).T


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_nearest_point_within_a_cell(dtype: torch.dtype) -> None:
    points, grid = grid_of(1500, dtype)
    asked = queries(20_000).to(dtype)
    index = grid.index(asked)
    exact, nearest = cKDTree(points.double().numpy()).query(asked.double().T.numpy())
    assert grid.cell == CELL
    # One cell each for the query and the point: neither lies more than half a diagonal off center.
    surely = torch.from_numpy(exact < BAND - DIAGONAL)
    surely_not = torch.from_numpy(exact > BAND + DIAGONAL)
    assert int(surely.sum()) > 500
    assert int(surely_not.sum()) > 500
    assert bool((index[surely] < len(points)).all())
    assert bool((index[surely_not] == len(points)).all())
    hit = index < len(points)
    apart = (asked.T[hit] - points[index[hit].long()]).double().norm(dim=1).numpy()
    excess = apart - exact[hit.numpy()]
    assert excess.min() > -1e-6
    assert excess.max() < 2 * DIAGONAL
    assert excess.mean() < 0.3 * CELL
    assert float(np.mean(index[hit].numpy() == nearest[hit.numpy()])) > 0.5


def test_a_point_finds_one_in_its_own_cell() -> None:
    points, grid = grid_of(800)
    difference = grid.difference(points.T)
    assert float(difference.norm(dim=0).max()) <= DIAGONAL
    assert float((difference.norm(dim=0) == 0).double().mean()) > 0.6


def test_far_queries_have_no_neighbor_on_any_side() -> None:
    points, grid = grid_of(400)
    directions = torch.cat([torch.eye(3), -torch.eye(3), torch.tensor([[1.0, -2, 3]])]).double()
    for distance in (1.5, 3.0, 1e3, 1e7):
        assert bool((grid.index(directions.T * distance) == len(points)).all())
        difference, normal = grid.nearest(directions.T * distance)
        assert float(difference.norm(dim=0).min()) > 100.0
        assert float(normal.abs().max()) == 0.0


def test_nearest_is_the_difference_and_the_normal_of_the_index() -> None:
    points, grid = grid_of(500)
    _, normals = teapot(500)
    asked = queries(300, seed=1).reshape(3, 10, 30)
    index = grid.index(asked)
    assert index.shape == (10, 30)
    difference, normal = grid.nearest(asked)
    assert torch.equal(difference, grid.difference(asked))
    hit = index < 500
    torch.testing.assert_close(difference[:, hit], asked[:, hit] - points[index[hit].long()].T)
    torch.testing.assert_close(normal[:, hit], normals[index[hit].long()].T)
    for one, item in zip(index, asked.unbind(1), strict=True):
        assert torch.equal(grid.index(item), one)


def test_stray_points_are_left_out_and_the_others_keep_their_index() -> None:
    points, normals = teapot(300)
    stray = torch.tensor([[1e3, 0, 0], [0, -1e6, 0]]).double()
    mixed = torch.cat([stray[:1], points, stray[1:]])
    up = torch.tensor([[0.0, 0, 1]]).double()
    grid = NearestGrid(mixed, torch.cat([up, normals, up]), cell=CELL, band=BAND)
    plain = NearestGrid(points, normals, cell=CELL, band=BAND)
    asked = queries(2000, seed=2)
    index, expected = grid.index(asked), plain.index(asked)
    hit = expected < 300
    assert torch.equal(index[hit], expected[hit] + 1)
    assert bool((index[~hit] == 302).all())
    assert bool((grid.index(stray.T) == 302).all())


def test_a_cloud_that_is_all_astray_still_has_neighbors() -> None:
    points, normals = teapot(100)
    grid = NearestGrid(points + 50.0, normals, cell=CELL, band=BAND)
    difference = grid.difference(points.T + 50.0)
    assert float(difference.norm(dim=0).max()) < 2 * DIAGONAL


def test_a_large_box_gets_larger_cells_and_stays_right() -> None:
    points, normals = teapot(200)
    grid = NearestGrid(points, normals, cell=1e-3, band=2e-3, reach=2.0)
    assert grid.cell > 1e-3
    difference = grid.difference(points.T)
    assert float(difference.norm(dim=0).max()) <= math.sqrt(3.0) * grid.cell


@pytest.mark.parametrize("kind", ["one point", "copies", "line", "plane"])
def test_degenerate_clouds(kind: str) -> None:
    points, normals = teapot(60)
    points = {
        "one point": points[:1],
        "copies": points[:1].expand(60, 3),
        "line": points * torch.tensor([1.0, 0, 0]),
        "plane": points * torch.tensor([1.0, 1.0, 0]),
    }[kind].double()
    grid = NearestGrid(points, normals[: len(points)], cell=CELL, band=BAND)
    difference = grid.difference(points.T)
    assert float(difference.norm(dim=0).max()) <= DIAGONAL
    beside = points + torch.tensor([0.0, 0, BAND + 2 * DIAGONAL])
    assert bool((grid.index(beside.T) == len(points)).all())


def test_queries_are_not_modified() -> None:
    _, grid = grid_of(100)
    asked = queries(50)
    before = asked.clone()
    grid.index(asked)
    grid.nearest(asked)
    assert torch.equal(asked, before)
