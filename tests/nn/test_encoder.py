"""The whole encoder: against its formulas, what leaves it unchanged, and what it must survive."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from nn_reference import SMALL, cloud, dense, encode, encoder, one, unit_normals

from fullturn.geometry.rigid import random_rotations_uniform
from fullturn.nn.clouds import CloudBatch
from fullturn.nn.config import PRESETS, GMCNetConfig
from fullturn.nn.encoder import Encoder

ABLATIONS: list[dict[str, Any]] = [
    {"graph": False},
    {"tpt": False},
    {"hgm": False},
    {"graph": False, "tpt": False, "hgm": False},
    {"tpt": False, "hgm": False},
    {"rif_only": True},
    {"rif_only": True, "features": "rri"},
    {"features": "rri", "graph": False},
    {"features": "fpfh"},
    {"features": "fpfh", "rif_only": True},
    {"orientation": "none"},
]


@pytest.mark.parametrize("rif_only", [False, True])
@pytest.mark.parametrize("features", ["ppf", "rri"])
def test_by_definition(features: str, rif_only: bool) -> None:
    net = encoder(replace(SMALL, features=features, rif_only=rif_only))
    points, normals = cloud(28, seed=0), unit_normals(28, seed=1)
    terms = net(one(points, normals))
    expected = encode(net, points.numpy(), normals.numpy())
    for term, reference in zip(terms, expected, strict=True):
        assert np.abs(reference).max() > 0.1
        np.testing.assert_allclose(term[0].detach(), reference, rtol=0, atol=1e-9)


@pytest.mark.parametrize("features", ["ppf", "rri", "fpfh"])
def test_a_batch_equals_each_cloud_alone(features: str) -> None:
    net = encoder(replace(SMALL, features=features))
    clouds = [cloud(n, seed=n) for n in (40, 25, 3, 40)]
    batch = CloudBatch.collate(clouds)
    terms = net(batch)
    for term in terms:
        assert (term[~batch.mask] == 0).all()
    for i, points in enumerate(clouds):
        for together, alone in zip(terms, net(one(points)), strict=True):
            torch.testing.assert_close(together[i, : len(points)], alone[0], atol=1e-12, rtol=1e-12)


@pytest.mark.parametrize(
    "changes",
    [
        {"orientation": "centroid"},
        {"orientation": "none"},
        {"features": "rri"},
        {"features": "fpfh", "orientation": "centroid"},
    ],
    ids=str,
)
def test_the_unary_term_does_not_see_the_pose(changes: dict[str, Any]) -> None:
    net = encoder(replace(SMALL, **changes))
    all_ri = encoder(replace(SMALL, rif_only=True, **changes))
    points = dense(100, seed=0)
    rng = np.random.default_rng(0)
    for R in random_rotations_uniform(5, rng=rng):
        moved = points @ R.mT + torch.from_numpy(rng.uniform(-5, 5, 3))
        before, after = net(one(points)), net(one(moved))
        torch.testing.assert_close(after[0], before[0], atol=1e-9, rtol=1e-9)
        # The others take coordinates in, unless told not to.
        assert (after[1] - before[1]).abs().max() > 1e-3
        for term, same in zip(all_ri(one(moved)), all_ri(one(points)), strict=True):
            torch.testing.assert_close(term, same, atol=1e-9, rtol=1e-9)


def test_the_papers_normals_see_rotations_about_the_origin_only() -> None:
    net = encoder(SMALL)
    points = dense(100, seed=0)
    R = random_rotations_uniform(1, rng=np.random.default_rng(0))[0]
    unary = net(one(points))[0]
    torch.testing.assert_close(net(one(points @ R.mT))[0], unary, atol=1e-9, rtol=1e-9)
    assert (net(one(points - 2 * points.mean(0)))[0] - unary).abs().max() > 1e-3


def test_permuted_points_have_permuted_descriptors() -> None:
    net = encoder(SMALL)
    points = dense(60, seed=0)
    # The first point stays: farthest point sampling starts there.
    order = torch.from_numpy(np.random.default_rng(0).permutation(59) + 1)
    order = torch.cat([torch.zeros(1, dtype=torch.int64), order])
    for term, same in zip(net(one(points[order])), net(one(points)), strict=True):
        torch.testing.assert_close(term[0], same[0, order], atol=1e-12, rtol=1e-12)


@pytest.mark.parametrize(
    ("config", "count"),
    [
        # With the fusing map (bias-free, all terms → 128) 283,446 and 337,176: as released.
        (PRESETS["clean"], 283_446 - 128 * 296),
        (replace(PRESETS["clean"], neighbors=(20, 20, 20)), 337_176 - 128 * 296),
        (replace(PRESETS["clean"], neighbors=(64, 64, 64)), 494_784 - 128 * 296),
    ],
    ids=["k=5", "k=20", "k=64"],
)
def test_parameter_counts(config: GMCNetConfig, count: int) -> None:
    assert sum(value.numel() for value in Encoder(config).parameters()) == count


@pytest.mark.parametrize("changes", ABLATIONS, ids=str)
def test_variants_run_and_learn(changes: dict[str, Any]) -> None:
    config = replace(SMALL, **changes)
    net = encoder(config).train()
    batch = CloudBatch.collate([cloud(40, seed=0), cloud(30, seed=1)])
    terms = net(batch)
    assert [term.shape[-1] for term in terms] == list(config.term_channels)
    sum(term.square().sum() for term in terms).backward()
    for name, value in net.named_parameters():
        assert value.grad is not None, f"{name} takes no part"
        assert torch.isfinite(value.grad).all(), name
    for name, part in net.named_children():
        assert any((value.grad != 0).any() for value in part.parameters()), name


def test_nothing_is_built_for_what_is_left_out() -> None:
    names = {
        name.split(".")[0] for name, _ in Encoder(replace(SMALL, hgm=False)).named_parameters()
    }
    assert names == {"ri", "unary", "beside", "nodes", "level1"}
    plain, full = Encoder(replace(SMALL, tpt=False)), Encoder(SMALL)
    assert not any("attend" in name for name, _ in plain.named_parameters())
    assert any("attend" in name for name, _ in full.named_parameters())


def test_padding_is_not_counted_in_training() -> None:
    clouds = [cloud(40, seed=0), cloud(20, seed=1)]
    batch = CloudBatch.collate(clouds)
    longer = CloudBatch.join([batch, CloudBatch.collate([cloud(90, seed=2)])])
    longer = CloudBatch(longer.points[:2], longer.mask[:2])
    results = []
    for some in (batch, longer):
        net = encoder(SMALL).train()
        terms = net(some)
        results.append([*(term[:, :40] for term in terms), *net.buffers()])
    for a, b in zip(*results, strict=True):
        torch.testing.assert_close(a, b)


DEGENERATE = {
    "one point": torch.zeros(1, 3),
    "coincident": torch.ones(9, 3),
    "collinear": torch.linspace(0, 1, 9)[:, None] * torch.tensor([1.0, 2.0, 3.0]),
    "planar": torch.cat([cloud(30, seed=0)[:, :2].float(), torch.zeros(30, 1)], 1),
    "duplicates": cloud(15, seed=0).float().repeat(2, 1),
    "four": cloud(4, seed=0).float(),
    "far": cloud(40, seed=0).float() + 1e6,
    "millimeters": cloud(40, seed=0).float() * 1e-3,
    "kilometers": cloud(40, seed=0).float() * 1e3,
}


@pytest.mark.parametrize("features", ["ppf", "rri", "fpfh"])
@pytest.mark.parametrize("points", DEGENERATE.values(), ids=DEGENERATE)
def test_degenerate_clouds_are_finite(points: torch.Tensor, features: str) -> None:
    net = encoder(replace(SMALL, features=features)).float()
    terms = net(one(points))
    assert all(torch.isfinite(term).all() for term in terms)
    sum(term.square().sum() for term in terms).backward()
    assert all(torch.isfinite(value.grad).all() for value in net.parameters())


def test_float32_is_near_float64() -> None:
    net = encoder(SMALL)
    points = dense(60, seed=0)
    precise = net(one(points))
    for term, rough in zip(precise, net.float()(one(points.float())), strict=True):
        assert rough.dtype == torch.float32
        torch.testing.assert_close(rough.double(), term, atol=2e-4, rtol=2e-4)
