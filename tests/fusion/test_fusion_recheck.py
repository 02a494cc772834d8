"""Each scan against the rest of its group as one cloud."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import torch
from fusion_cases import HALF_TURN, between, case, edge, errors, seen_from

from fullturn.fusion.connect import refine_groups
from fullturn.fusion.edges import Registrar
from fullturn.fusion.graph import GraphConfig, placement_at
from fullturn.fusion.recheck import recheck_scans
from fullturn.fusion.scans import check_scans, thinned
from fullturn.geometry.motion import invert


@pytest.mark.parametrize("turned", [None, 0, 4])
def test_a_scan_that_its_pairs_turned_is_turned_back(turned: int | None) -> None:
    scans, truth, _, edges = case(0.5, 0)
    poses = truth.copy()
    if turned is not None:
        poses[turned] = HALF_TURN @ poses[turned]
    placed = invert(poses[[0]]) @ poses
    config, group = GraphConfig(), list(range(len(scans)))
    placement = placement_at(edges, [group], placed, config)
    assert placement.groups == (tuple(group),)
    surfaces = [thinned(scan, 1.0) for scan in scans]
    with Registrar(length=1.0, method="auto", seed=0, workers=1) as registrar:
        found, again, changed = recheck_scans(
            registrar, scans, 1.0, surfaces, config, edges, placement, placed, progress=False
        )
    assert changed == (turned is not None)
    assert again.groups == placement.groups
    assert {edge.source for edge in found[len(edges) :]} == ({turned} - {None})
    unmoved = [scan for scan in group if scan != turned]
    np.testing.assert_array_equal(again.probability[unmoved], placement.probability[unmoved])
    if turned is not None:
        assert again.probability[turned] > 0.3
    refined, _ = refine_groups(scans, 1.0, found, again)
    for T in (again.T_group_scan, refined):
        for scan in group:
            angle, shift = errors(T[scan], between(truth, 0, scan))
            assert angle < 1.0
            assert shift < 0.02


def bumpy(rng: np.random.Generator) -> torch.Tensor:
    """A star-shaped surface like no other."""
    u, bumps = (rng.normal(size=(count, 3)) for count in (4000, 6))
    u, bumps = (some / np.linalg.norm(some, axis=1, keepdims=True) for some in (u, bumps))
    near = np.exp(-np.square(u[:, None] - bumps).sum(-1) / 0.15)
    return torch.from_numpy(u * (1.0 + near @ rng.uniform(-0.5, 0.6, size=(6, 1))))


def test_scans_that_find_no_place_in_one_another_fall_apart() -> None:
    config = GraphConfig()
    rng = np.random.default_rng(0)
    scans, truth, _, edges = case(0.5, 0)
    strangers, _ = check_scans([seen_from(bumpy(rng), rng.normal(size=3)) for _ in range(4)])
    known, wrong = list(range(len(scans))), list(range(len(scans), len(scans) + len(strangers)))
    edges += [edge(i, j, [np.eye(4)], [0.6]) for i, j in combinations(wrong, 2)]
    poses = np.concatenate([invert(truth[[0]]) @ truth, np.tile(np.eye(4), (4, 1, 1))])
    placement = placement_at(edges, [known, wrong], poses, config)
    assert placement.groups == (tuple(known), tuple(wrong))
    assert (placement.probability[wrong] > 0.9).all()
    everything = [*scans, *strangers]
    surfaces = [thinned(scan, 1.0) for scan in everything]
    with Registrar(length=1.0, method="auto", seed=0, workers=1) as registrar:
        found, again, changed = recheck_scans(
            registrar, everything, 1.0, surfaces, config, edges, placement, poses, progress=False
        )
    assert changed
    assert len(found) == len(edges)
    assert again.groups == (tuple(known), *((scan,) for scan in wrong))
    np.testing.assert_array_equal(again.probability[known], placement.probability[known])
    assert np.isnan(again.probability[wrong]).all()
    np.testing.assert_array_equal(again.T_group_scan[wrong], np.tile(np.eye(4), (4, 1, 1)))


def test_what_fits_after_a_scan_was_moved_joins() -> None:
    config = GraphConfig()
    scans, truth, _, edges = case(0.5, 0)
    turned, lone = 4, 5
    poses = invert(truth[[0]]) @ truth
    poses[turned] = invert(truth[0]) @ HALF_TURN @ truth[turned]
    poses[lone] = np.eye(4)
    edges = [e for e in edges if lone not in (e.target, e.source)]
    edges += [edge(i, lone, [between(truth, i, lone)], [0.6]) for i in (0, turned)]
    placement = placement_at(edges, [[0, 1, 2, 3, 4], [lone]], poses, config)
    assert placement.groups == ((0, 1, 2, 3, 4), (lone,))
    surfaces = [thinned(scan, 1.0) for scan in scans]
    with Registrar(length=1.0, method="auto", seed=0, workers=1) as registrar:
        _, again, changed = recheck_scans(
            registrar, scans, 1.0, surfaces, config, edges, placement, poses, progress=False
        )
    assert changed
    assert again.groups == (tuple(range(len(scans))),)
    assert again.probability[lone] > 0.8
    for scan in again.groups[0]:
        angle, _ = errors(again.T_group_scan[scan], between(truth, 0, scan))
        assert angle < 1.0
