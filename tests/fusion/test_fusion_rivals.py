"""What sensors must have seen, the rivals of an assembly, and which scans stay together."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
import torch
from fusion_cases import LOOKS, between, case, edge, errors, seen_from, surface

from fullturn.fusion.graph import GraphConfig, place_scans, placement_at
from fullturn.fusion.rivals import Eyes, judge_group
from fullturn.fusion.scans import check_scans
from fullturn.fusion.settle import _parts, settle_groups
from fullturn.fusion.sight import Sights
from fullturn.pose.visibility import DepthImages


@pytest.mark.parametrize("seed", range(3))
def test_a_known_sensor_contradicts_what_a_depth_image_contradicts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    look = rng.normal(size=3)
    seen = torch.from_numpy(seen_from(surface(bump=0.5), look)).float()
    eye = torch.from_numpy(4.0 * look / np.linalg.norm(look)).float()
    others = torch.from_numpy(rng.uniform(-1.2, 1.2, size=(5, 400, 3))).float()
    expected = DepthImages(seen, eye[None], spacing=0.05).violations(others)[0, :, :2].sum(-1)
    found = Sights(seen, spacing=0.05, viewpoint=eye).contradicted(others)
    assert found.shape == (1, 5)
    torch.testing.assert_close(found[0], expected, atol=0.02, rtol=0.0)


@pytest.mark.parametrize("look", LOOKS[:4])
def test_the_rest_of_a_surface_contradicts_no_likely_place_but_a_screen_does(
    look: np.ndarray,
) -> None:
    points = surface(bump=0.5)
    seen = torch.from_numpy(seen_from(points, look)).float()
    sights = Sights(seen, spacing=0.05)
    whole = sights.contradicted(points[None, ::10].float())[:, 0]
    assert float((sights.hidden + whole).min() - sights.hidden.min()) < 0.1
    # The same surface all around, a little larger, hides what was seen, wherever from.
    screen = sights.contradicted(1.5 * points[None, ::10].float())[:, 0]
    assert float(screen.min()) > 0.2


@pytest.mark.parametrize(("seed", "right"), [(0, 0.4), (1, 0.4), (2, 0.4), (0, 0.2), (1, 0.2)])
def test_scans_that_the_edges_turned_are_turned_back(seed: int, right: float) -> None:
    scans, truth, turned, edges = case(0.5, seed, right=right)
    group = range(len(scans))
    eyes = Eyes(scans, group, 1.0)
    judged = judge_group(eyes, group, turned, edges, GraphConfig())
    assert judged is not None
    assert judged.is_moved
    for i, j in combinations(group, 2):
        angle, shift = errors(between(judged.T_group_scan, i, j), between(truth, i, j))
        assert angle < 0.1
        assert shift < 1e-6
    stays = judge_group(eyes, group, truth, edges, GraphConfig())
    assert stays is not None
    assert not stays.is_moved
    np.testing.assert_array_equal(stays.T_group_scan, truth)
    np.testing.assert_allclose(stays.together, stays.together.T)
    np.testing.assert_allclose(np.diag(stays.together), 1.0)
    # The same assemblies, whichever of them was there before.
    np.testing.assert_allclose(judged.together, stays.together, atol=0.01)


@pytest.mark.parametrize(("right", "is_moved"), [(0.4, False), (0.2, True)])
def test_what_edges_alone_say_moves_scans_only_where_it_is_sure(
    right: float, is_moved: bool
) -> None:
    scans, truth, turned, edges = case(0.0, 0, right=right)
    group = range(len(scans))
    judged = judge_group(Eyes(scans, group, 1.0), group, truth, edges, GraphConfig())
    assert judged is not None
    assert judged.is_moved == is_moved
    for i, j in combinations(group, 2):
        expected = between(turned if is_moved else truth, i, j)
        np.testing.assert_allclose(between(judged.T_group_scan, i, j), expected, atol=1e-6)


def test_a_scan_smaller_than_a_cell_stays_with_the_others() -> None:
    scans, truth, _, edges = case(0.5, 0)
    (patch, _), _ = check_scans([scans[0].points()[:12] * 1e-3, scans[1].points()])
    group = range(len(scans))
    judged = judge_group(Eyes([patch, *scans[1:]], group, 1.0), group, truth, edges, GraphConfig())
    assert judged is not None
    assert judged.together.shape == (len(scans), len(scans))


def test_turns_of_a_symmetric_shape_part_nothing() -> None:
    scans, truth, _, edges = case(0.0, 0)
    group = range(len(scans))
    judged = judge_group(Eyes(scans, group, 1.0), group, truth, edges, GraphConfig())
    assert judged is not None
    np.testing.assert_allclose(judged.together, 1.0, atol=1e-9)


def test_without_other_poses_there_are_no_rivals() -> None:
    scans, truth, _, edges = case(0.5, 1)
    sure = [edge(e.target, e.source, [between(truth, e.target, e.source)], [0.9]) for e in edges]
    group = range(len(scans))
    assert judge_group(Eyes(scans, group, 1.0), group, truth, sure, GraphConfig()) is None


def test_settled_groups_are_right_and_others_stay_as_they_were() -> None:
    scans, truth, _, edges = case(0.5, 2)
    config = GraphConfig()
    placement = place_scans(len(scans), edges, config)
    assert len(placement.groups[0]) == len(scans)
    settled, changed = settle_groups(scans, 1.0, edges, placement, placement.T_group_scan, config)
    assert changed
    assert settled.groups == placement.groups
    assert (settled.probability > 0.5).all()
    for scan in settled.groups[0]:
        angle, _ = errors(settled.T_group_scan[scan], between(truth, 0, scan))
        assert angle < 1.0
    again, changed = settle_groups(scans, 1.0, edges, settled, settled.T_group_scan, config)
    assert not changed
    np.testing.assert_array_equal(again.T_group_scan, settled.T_group_scan)
    two = placement_at(edges, [[0, 1], [2, 3, 4, 5]], settled.T_group_scan, config)
    assert {len(group) for group in two.groups} == {2, 4}


def test_groups_seen_from_known_places_stay_as_the_pairs_placed_them() -> None:
    scans, _, turned, edges = case(0.5, 0)
    told = [replace(scan, viewpoint=np.ones(3)) for scan in scans]
    placement = placement_at(edges, [list(range(len(scans)))], turned, GraphConfig())
    poses = placement.T_group_scan
    settled, changed = settle_groups(told, 1.0, edges, placement, poses, GraphConfig())
    assert not changed
    np.testing.assert_array_equal(settled.T_group_scan, poses)
    np.testing.assert_array_equal(settled.probability, placement.probability)


def test_chains_of_sure_pairs_hold_scans_together() -> None:
    sure = np.eye(5)
    for i, j in ((0, 3), (3, 4), (1, 2)):
        sure[i, j] = sure[j, i] = 0.9
    assert _parts(range(5), sure) == [[0, 3, 4], [1, 2]]
    assert _parts(range(5), np.eye(5)) == [[0], [1], [2], [3], [4]]
    assert _parts([1, 2, 4], np.ones((5, 5))) == [[1, 2, 4]]
