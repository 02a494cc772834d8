"""Which poses the cycles choose, and which scans stay apart."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from fusion_cases import between, edge, errors, jitter, random_pose, random_poses

from fullturn.fusion.edges import failed_edge
from fullturn.fusion.graph import GraphConfig, Placement, join_groups, place_scans
from fullturn.fusion.posterior import Measurement, posterior


def check_poses(placement: Placement, truth: np.ndarray, *, deg: float, shift: float) -> None:
    for group in placement.groups:
        for scan in group:
            angle, moved = errors(placement.T_group_scan[scan], between(truth, group[0], scan))
            assert angle < deg
            assert moved < shift


def test_one_edge_gives_back_its_probabilities() -> None:
    rng = np.random.default_rng(0)
    p = np.array([0.5, 0.3, 0.1])
    heard = [Measurement(random_poses(3, rng), p, 0.1, 0.1)]
    found = posterior(heard, np.zeros(3), GraphConfig())
    np.testing.assert_allclose(found.T_one_other, heard[0].T_one_other, atol=1e-12)
    # The doubt also speaks beside each pose, at ε of its weight.
    np.testing.assert_allclose(found.probability, p, atol=0.02)
    assert found.none == pytest.approx(0.1, abs=0.02)
    np.testing.assert_allclose(found.shares[:, 0], p)
    # Of poses that agree, the probabilities count together.
    near = Measurement(heard[0].T_one_other[[0, 0, 1]], p, 0.1, 0.1)
    found = posterior([near], np.zeros(3), GraphConfig())
    np.testing.assert_allclose(found.T_one_other, near.T_one_other[[0, 2]], atol=1e-12)
    np.testing.assert_allclose(found.probability, [0.8, 0.1], atol=0.03)
    # … and so do those of turns of a symmetric shape, of which the most probable one is returned.
    turns = np.array([[True, False, True], [False, True, False], [True, False, True]])
    found = posterior(heard, np.zeros(3), GraphConfig(), turns)
    np.testing.assert_allclose(found.T_one_other, heard[0].T_one_other[:2], atol=1e-12)
    np.testing.assert_allclose(found.probability, [0.6, 0.3], atol=0.03)


def test_doubt_for_other_turns_is_no_doubt_of_all() -> None:
    rng = np.random.default_rng(2)
    heard = [Measurement(random_poses(3, rng), np.array([0.2, 0.2, 0.1]), 0.5, 0.05)]
    found = posterior(heard, np.zeros(3), GraphConfig())
    assert found.none < 0.1
    # Between the poses, nothing changes.
    np.testing.assert_allclose(found.probability[:2] / found.probability[0], 1.0, atol=1e-9)
    any_turn = edge(0, 1, random_poses(3, rng), [0.2, 0.2, 0.1], symmetry=0)
    assert any_turn.doubt == pytest.approx(0.5)
    assert any_turn.none == 0.05
    for symmetry in (None, 2):  # few turns, all of which are named
        assert edge(0, 1, random_poses(1, rng), [0.5], symmetry=symmetry).none == 0.5
    assert edge(0, 1, random_poses(1, rng), [0.1], symmetry=0).none == 0.9  # hardly says anything


def test_poses_that_are_impossible_say_nothing() -> None:
    rng = np.random.default_rng(4)
    truth = random_poses(3, rng)
    sure = edge(0, 1, [between(truth, 0, 1), random_pose(rng)], [0.9, 0.0])
    out = [edge(i, 2, [random_pose(rng)], [0.0]) for i in (0, 1)]
    placement = place_scans(3, [sure, *out], GraphConfig())
    assert placement.groups == ((0, 1), (2,))
    check_poses(placement, truth, deg=1e-6, shift=1e-9)


def test_edges_that_agree_raise_each_other_and_contradiction_lowers() -> None:
    rng = np.random.default_rng(1)
    T, other = random_pose(rng)[None], random_pose(rng)[None]
    one = Measurement(T, np.array([0.6]), 0.4, 0.4)
    agreeing = Measurement(jitter(T, rng, deg=2, shift=0.01), np.array([0.4]), 0.6, 0.6)
    against = Measurement(other, np.array([0.95]), 0.05, 0.05)
    alone, both, contested = (
        posterior(heard, np.zeros(3), GraphConfig()).probability
        for heard in ([one], [one, agreeing], [one, against])
    )
    assert both[0] > 0.9 > alone[0]
    assert contested.sum() <= 1.0
    assert contested[0] > 0.5  # of the other pose


@pytest.mark.parametrize("seed", range(4))
def test_cycles_decide_between_alternatives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = random_poses(7, rng)
    flip = np.diag([-1.0, -1.0, 1.0, 1.0])
    edges = []
    for i, j in combinations(range(7), 2):
        T = jitter(between(truth, i, j), rng, deg=1.0, shift=0.01)
        # Sure ones along a path; of the others the wrong pose comes first.
        if j == i + 1:
            edges.append(edge(i, j, [T], [0.95]))
        else:
            edges.append(edge(i, j, [T @ flip, T, random_pose(rng)], [0.5, 0.4, 0.02]))
    placement = place_scans(7, edges)
    assert placement.groups == (tuple(range(7)),)
    check_poses(placement, truth, deg=8.0, shift=0.1)
    assert all(
        chosen == (0 if e.source == e.target + 1 else 1)
        for e, chosen in zip(edges, placement.chosen, strict=True)
    )
    assert (placement.probability > 0.9).all()


def test_only_unsure_edges_still_find_the_common_truth() -> None:
    rng = np.random.default_rng(5)
    truth = random_poses(6, rng)
    edges = [
        edge(i, j, [random_pose(rng), between(truth, i, j)], [0.4, 0.35])
        for i, j in combinations(range(6), 2)
    ]
    # Nothing alone is firm enough, so nothing is joined: an honest answer.
    assert all(len(group) == 1 for group in place_scans(6, edges).groups)
    edges[0] = edge(0, 1, [between(truth, 0, 1)], [0.9])
    placement = place_scans(6, edges)
    assert placement.groups[0] == tuple(range(6))
    check_poses(placement, truth, deg=0.1, shift=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_a_wrong_confident_edge_is_rejected(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = random_poses(5, rng)
    edges = [
        edge(i, j, [jitter(between(truth, i, j), rng, deg=1, shift=0.01)], [0.93])
        for i, j in combinations(range(5), 2)
    ]
    edges[0] = edge(0, 1, [random_pose(rng)], [0.99])
    placement = place_scans(5, edges)
    assert placement.groups == (tuple(range(5)),)
    assert placement.chosen[0] == -1
    assert set(placement.chosen[1:]) == {0}
    check_poses(placement, truth, deg=6.0, shift=0.1)


def test_unsure_edges_between_two_objects_join_nothing() -> None:
    rng = np.random.default_rng(3)
    truth = random_poses(9, rng)
    edges = [failed_edge(0, 8, "no answer")]
    for i, j in combinations(range(8), 2):
        if (i < 5) == (j < 5):
            edges.append(edge(i, j, [between(truth, i, j)], [0.9]))
        else:
            edges.append(edge(i, j, [random_pose(rng) for _ in range(3)], [0.3, 0.1, 0.05]))
    placement = place_scans(9, edges)
    assert placement.groups == ((0, 1, 2, 3, 4), (5, 6, 7), (8,))
    assert placement.chosen[0] == -1
    assert np.isnan(placement.probability[8])
    check_poses(placement, truth, deg=0.1, shift=1e-6)


def test_weak_edges_that_share_a_mistake_join_nothing() -> None:
    rng = np.random.default_rng(7)
    truth = random_poses(6, rng)
    flip = random_pose(rng)
    mistaken = np.stack([T if scan < 4 else flip @ T for scan, T in enumerate(truth)])
    edges = []
    for i, j in combinations(range(6), 2):
        sure = (i < 4) == (j < 4)
        edges.append(edge(i, j, [between(mistaken, i, j)], [0.9 if sure else 0.3]))
    placement = place_scans(6, edges)
    assert placement.groups == ((0, 1, 2, 3), (4, 5))


def test_turns_of_a_symmetric_shape_join_but_mere_doubt_does_not() -> None:
    rng = np.random.default_rng(0)
    T = random_pose(rng)
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    half = rng.uniform(-1.0, 1.0, (500, 3)) * [1.0, 0.6, 0.3]
    symmetric = np.concatenate([half, half @ turn[:3, :3]])
    edges = [edge(0, 1, [T, T @ turn], [0.49, 0.48])]
    for surfaces, groups in (
        (None, 2),
        ([half * [1, 2, 1] + half[:, :1]] * 2, 2),
        ([symmetric] * 2, 1),
    ):
        assert len(place_scans(2, edges, surfaces=surfaces).groups) == groups
    joined = place_scans(2, edges, surfaces=[symmetric] * 2)
    assert joined.probability[1] == pytest.approx(0.5, abs=0.05)  # honest about which turn it is
    # Two scans from one side may show too little; what the registration says counts, too.
    said = [edge(0, 1, [T, T @ turn], [0.49, 0.48], symmetry=2)]
    assert len(place_scans(2, said).groups) == 1
    # That the shape is symmetric says nothing for edges that doubt all of it.
    doubted = [edge(0, 1, [T, T @ turn], [0.3, 0.3])]
    assert len(place_scans(2, doubted, surfaces=[symmetric] * 2).groups) == 2


def test_pairs_that_are_sure_of_different_turns_join_where_the_whole_is_symmetric() -> None:
    """Three scans of a body that half a turn leaves as it is; of the fourth, each is sure."""
    rng = np.random.default_rng(1)
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    half = rng.uniform(-1.0, 1.0, (500, 3)) * [1.0, 0.6, 0.3]
    body = np.concatenate([half, half @ turn[:3, :3]])
    truth = random_poses(4, rng)
    surfaces = [(body - T[:3, 3]) @ T[:3, :3] for T in truth]
    edges = [edge(i, j, [between(truth, i, j)], [0.95]) for i, j in combinations(range(3), 2)]
    for i, motion in enumerate((np.eye(4), turn)):
        edges.append(edge(i, 3, [np.linalg.inv(truth[i]) @ motion @ truth[3]], [0.8]))
    assert place_scans(4, edges).groups == ((0, 1, 2), (3,))
    joined = place_scans(4, edges, surfaces=surfaces)
    assert joined.groups == ((0, 1, 2, 3),)


def test_the_order_of_scans_changes_no_groups() -> None:
    rng = np.random.default_rng(11)
    truth = random_poses(8, rng)
    edges = []
    for i, j in combinations(range(8), 2):
        wrong = random_pose(rng)
        same = (i < 4) == (j < 4)
        poses = [between(truth, i, j), wrong] if same else [wrong]
        edges.append(edge(i, j, poses, [0.7, 0.2] if same else [0.2]))
    groups = {frozenset(group) for group in place_scans(8, edges).groups}
    order = rng.permutation(8)
    renamed = [
        edge(int(order[e.target]), int(order[e.source]), e.T_target_source, e.probability)
        for e in edges
    ]
    back = np.argsort(order)
    again = place_scans(8, renamed).groups
    assert {frozenset(int(back[s]) for s in group) for group in again} == groups


def test_scans_without_edges_are_alone() -> None:
    placement = place_scans(3, [])
    assert placement.groups == ((0,), (1,), (2,))
    np.testing.assert_array_equal(placement.T_group_scan, np.tile(np.eye(4), (3, 1, 1)))


def test_groups_join_at_their_poses_though_pairs_in_them_disagree() -> None:
    rng = np.random.default_rng(3)
    truth = random_poses(5, rng)
    placed = truth.copy()
    placed[1:4] = np.linalg.inv(truth[1]) @ truth[1:4]
    edges = [edge(1, j, [between(truth, 1, j)], [0.9]) for j in (2, 3)]
    edges += [edge(2, 3, [random_pose(rng)], [0.9])]  # outvoted before
    placement = Placement(((1, 2, 3), (0,), (4,)), placed, np.full(5, np.nan), ())
    links = [edge(0, j, [between(truth, 0, j)], [0.9]) for j in (1, 2)]
    found = join_groups([*edges, *links], placement, GraphConfig())
    assert found.groups == ((0, 1, 2, 3), (4,))
    check_poses(found, truth, deg=1e-4, shift=1e-6)
    assert join_groups(edges, placement, GraphConfig()).groups == placement.groups
