"""The feature graphs: against loops, with few points, and what normals they take."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from nn_reference import (
    SMALL,
    cloud,
    dense,
    farthest,
    interpolate,
    nearest,
    one,
    relation,
    unit_normals,
)

from fullturn.features.fpfh import fpfh
from fullturn.features.ppf import ppf
from fullturn.geometry.neighbors import radius_neighbors
from fullturn.geometry.normals import estimate_normals
from fullturn.geometry.rigid import random_rotations_uniform
from fullturn.nn.clouds import CloudBatch
from fullturn.nn.graphs import build_graphs


@pytest.mark.parametrize("neighbors", [(5, 4, 3), (3, 5, 7)], ids=str)
@pytest.mark.parametrize("rif_only", [False, True])
@pytest.mark.parametrize("features", ["ppf", "rri"])
def test_levels_by_definition(features: str, rif_only: bool, neighbors: tuple) -> None:
    config = replace(SMALL, features=features, rif_only=rif_only, neighbors=neighbors)
    points, normals = cloud(28, seed=0), unit_normals(28, seed=1)
    graphs = build_graphs(one(points, normals), config)
    at, n_at = (points - points.mean(0)).numpy(), normals.numpy()
    chosen2 = farthest(at, 14)
    chosen3 = farthest(at[chosen2], 7)
    below = [(at, n_at), (at, n_at), (at[chosen2], n_at[chosen2])]
    centers = [list(range(28)), chosen2, chosen3]
    for level, (p, n), rows, k in zip(graphs.levels, below, centers, neighbors, strict=True):
        assert (level.centers is None) or level.centers.tolist() == rows
        for row, i in enumerate(rows):
            js = nearest(p, i, k)
            assert level.neighbors[row].tolist() == js
            np.testing.assert_allclose(
                level.relation[row], relation(config, p, n, i, js), rtol=0, atol=1e-7
            )


def test_interpolation_by_definition() -> None:
    points = cloud(20, seed=0)
    graphs = build_graphs(one(points, unit_normals(20, seed=1)), SMALL)
    values = torch.from_numpy(np.random.default_rng(2).standard_normal((10, 4)))
    at = (points - points.mean(0)).numpy()
    chosen = farthest(at, 10)
    for back, count in zip(graphs.back, (10, 5), strict=True):
        result = back(values[:count])
        expected = [interpolate(at[chosen[:count]], list(values[:count].numpy()), p) for p in at]
        np.testing.assert_allclose(result, np.array(expected), rtol=0, atol=1e-12)
        # A point of the coarse level has its own value.
        torch.testing.assert_close(result[chosen[:count]], values[:count], atol=1e-7, rtol=0)


@pytest.mark.parametrize("features", ["ppf", "rri", "fpfh"])
@pytest.mark.parametrize("n", [1, 2, 4])
def test_fewer_points_than_neighbors(n: int, features: str) -> None:
    config = replace(SMALL, features=features, neighbors=(64, 64, 64))
    graphs = build_graphs(one(cloud(n, seed=0)), config)
    for level in graphs.levels:
        rows = level.neighbors.shape[0]
        assert level.neighbors.shape == (rows, 64)
        assert (level.neighbors >= 0).all()
        assert torch.isfinite(level.relation).all()
    for back in graphs.back:
        torch.testing.assert_close(back.weights.sum(-1), torch.ones(n).double())


@pytest.mark.parametrize("orientation", ["origin", "centroid", "none"])
def test_normals_are_those_of_the_posed_cloud(orientation: str) -> None:
    points = dense(100, seed=0)
    graphs = build_graphs(one(points), replace(SMALL, orientation=orientation))
    near, _ = radius_neighbors(points, points, 0.1, max_neighbors=30)
    normals = estimate_normals(points, neighbor_index=near, orientation=orientation)
    neighbors = graphs.levels[0].neighbors
    expected = ppf(points, normals, neighbors, fold=orientation == "none")
    expected[..., 3] /= 0.05
    torch.testing.assert_close(graphs.levels[0].relation[..., 6:], expected, atol=1e-9, rtol=0)


def test_the_origin_rule_depends_on_where_the_cloud_stands() -> None:
    points = dense(100, seed=0)
    moved = points - 2 * points.mean(0)
    ri = [build_graphs(one(some), SMALL).ri for some in (points, moved)]
    assert (ri[0] - ri[1]).abs().max() > 0.1
    config = replace(SMALL, orientation="centroid")
    ri = [build_graphs(one(some), config).ri for some in (points, moved)]
    torch.testing.assert_close(ri[0], ri[1], atol=1e-9, rtol=0)


def test_fpfh_is_for_nodes_and_ppf_for_edges() -> None:
    batch = CloudBatch.collate([cloud(60, seed=0), cloud(50, seed=1)])
    graphs, plain = (build_graphs(batch, replace(SMALL, features=f)) for f in ("fpfh", "ppf"))
    assert torch.equal(graphs.levels[0].relation, plain.levels[0].relation)
    for first, points in ((0, cloud(60, seed=0)), (60, cloud(50, seed=1))):
        near, _ = radius_neighbors(points, points, 0.1, max_neighbors=30)
        normals = estimate_normals(points, neighbor_index=near, orientation="origin")
        expected = fpfh(points - points.mean(0), normals)
        torch.testing.assert_close(graphs.ri[first : first + len(points)], expected)


def test_relations_turn_with_the_cloud() -> None:
    R = random_rotations_uniform(1, rng=np.random.default_rng(0))[0]
    points, normals = cloud(40, seed=0), unit_normals(40, seed=1)
    plain, turned = (
        build_graphs(one(points @ A.mT, normals @ A.mT), SMALL) for A in (torch.eye(3).double(), R)
    )
    for a, b in zip(plain.levels, turned.levels, strict=True):
        assert torch.equal(a.neighbors, b.neighbors)
        torch.testing.assert_close(a.relation[..., 6:], b.relation[..., 6:])
        torch.testing.assert_close(a.relation[..., :3] @ R.mT, b.relation[..., :3])
        torch.testing.assert_close(a.relation[..., 3:6] @ R.mT, b.relation[..., 3:6])
