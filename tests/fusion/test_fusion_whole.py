"""Whole groups as one cloud: which are tried, what their edges say of single scans, what joins."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import torch
from fusion_cases import between, edge, errors, random_pose, random_poses

from fullturn.fusion.edges import Edge, edge_of
from fullturn.fusion.graph import place_scans
from fullturn.fusion.scans import Scan, check_scans
from fullturn.fusion.whole import anchored, current, group_body, next_attempts
from fullturn.geometry import rigid
from fullturn.result import Registration

GROUPS = ((0, 1, 2), (3, 4), (5,), (6,))


def bumpy(rng: np.random.Generator, count: int = 900) -> np.ndarray:
    u = rng.normal(size=(count, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return u * (1 + 0.3 * np.sin(3 * u[:, :1] + 1) + 0.2 * u[:, 1:2] * u[:, 2:])


def scans_at(truth: np.ndarray, rng: np.random.Generator) -> list[Scan]:
    """Scans of one surface in their own frames, T_object_scan given."""
    clouds = [
        (points - T[:3, 3]) @ T[:3, :3]
        for T, points in ((T, bumpy(rng, 700 + 10 * k)) for k, T in enumerate(truth))
    ]
    return check_scans(clouds)[0]


def centered_truth(truth: np.ndarray, scans: list[Scan], length: float) -> np.ndarray:
    """The same poses between centers, in units of the fusion."""
    result = truth.copy()
    for T, scan in zip(result, scans, strict=True):
        T[:3, 3] = (T[:3, :3] @ scan.center + T[:3, 3]) / length
    return result


def test_every_two_groups_are_tried_once_the_largest_first() -> None:
    done: set[tuple[tuple[int, ...], tuple[int, ...]]] = set()
    rounds = []
    while todo := next_attempts(GROUPS, done):
        rounds.append(todo)
        done |= set(todo)
    assert rounds == [
        [(GROUPS[0], other) for other in GROUPS[1:]],
        [(GROUPS[1], other) for other in GROUPS[2:]],  # lone scans have met as a pair
    ]
    # A group that has grown is another one.
    assert next_attempts(((0, 1, 2, 5), (3, 4)), done) == [((0, 1, 2, 5), (3, 4))]


@pytest.mark.parametrize("length", [1e-3, 1.0, 1e3])
def test_an_exact_edge_between_groups_is_exact_between_scans(length: float) -> None:
    rng = np.random.default_rng(0)
    truth = random_poses(5, rng)
    truth[:, :3, 3] *= length
    base = scans_at(np.tile(np.eye(4), (5, 1, 1)), rng)
    clouds = [
        (length * scan.points() - T[:3, 3]) @ T[:3, :3] for scan, T in zip(base, truth, strict=True)
    ]
    scans = check_scans(clouds)[0]
    centers = centered_truth(truth, scans, length)
    groups = ((0, 1, 2), (3, 4))
    poses = np.concatenate(
        [np.linalg.inv(centers[group[0]]) @ centers[list(group)] for group in groups]
    )
    bodies = tuple(group_body(group, scans, poses, length) for group in groups)
    for body, group in zip(bodies, groups, strict=True):
        # One surface, in the frame of the group's first scan, centered on its mean.
        assert len(body.points()) < sum(scans[s].count for s in group)
        np.testing.assert_allclose(body.points().mean(0), 0.0, atol=1e-9 * length)
    frames = []
    for body, group in zip(bodies, groups, strict=True):
        shift = np.eye(4)
        shift[:3, 3] = body.center / length
        frames.append(centers[group[0]] @ shift)
    said = edge(0, 1, [np.linalg.inv(frames[0]) @ frames[1]], [0.9])
    found = anchored(said, groups, bodies, poses, length)
    assert (found.target, found.source, found.sides) == (0, 3, groups)
    angle, moved = errors(found.T_target_source[0], between(centers, 0, 3))
    assert angle < 1e-5
    assert moved < 1e-9


def test_a_covariance_travels_with_its_edge() -> None:
    rng = np.random.default_rng(1)
    scans = scans_at(random_poses(4, rng), rng)
    poses = random_poses(4, rng)
    groups = ((0, 1), (2, 3))
    bodies = tuple(group_body(group, scans, poses, 1.0) for group in groups)
    T = random_pose(rng)
    root = rng.normal(size=(6, 6))
    said = Edge(0, 1, T[None], np.array([0.9]), ((0.5, 0.5),), root @ root.T)
    found = anchored(said, groups, bodies, poses, 1.0)
    # The same small motions, one by one.
    step = 1e-6
    moved = []
    for xi in step * np.eye(6):
        nudged = T @ rigid.exp_se3(torch.from_numpy(xi)).numpy()
        other = anchored(edge(0, 1, [nudged], [0.9]), groups, bodies, poses, 1.0)
        difference = np.linalg.inv(found.T_target_source[0]) @ other.T_target_source[0]
        moved.append(rigid.log_se3(torch.from_numpy(difference)).numpy() / step)
    J = np.stack(moved, axis=1)
    np.testing.assert_allclose(found.covariance, J @ root @ root.T @ J.T, rtol=1e-4, atol=1e-4)


def test_a_lone_scan_is_registered_as_it_is() -> None:
    rng = np.random.default_rng(2)
    scans = scans_at(random_poses(3, rng), rng)
    assert group_body((1,), scans, random_poses(3, rng), 1.0) is scans[1]


def test_a_cloud_is_known_by_its_scans_and_poses() -> None:
    rng = np.random.default_rng(3)
    scans = scans_at(random_poses(3, rng), rng)
    poses, others = random_poses(3, rng), random_poses(3, rng)
    keys = [
        group_body(group, scans, T, 1.0).key
        for group, T in (((0, 1), poses), ((0, 1), poses), ((0, 2), poses), ((0, 1), others))
    ]
    assert keys[0] == keys[1]
    assert len(set(keys)) == 3


def test_what_was_said_of_smaller_groups_falls() -> None:
    def held(a: tuple[int, ...], b: tuple[int, ...]) -> Edge:
        said = edge(a[0], b[0], [np.eye(4)], [0.5])
        return Edge(**{**said.__dict__, "held": (a, b)})

    small, turned, grown = held((0, 1), (3,)), held((3,), (0, 1)), held((0, 1, 2), (3,))
    other = held((0, 1), (4,))
    groups = ((0, 1, 2), (3,), (4,))
    assert current([small, other, grown], groups) == [other, grown]
    assert current([turned, grown], groups) == [grown]
    assert current([small, other], ((0, 2), (1,), (3,), (4,))) == []


def test_a_firm_edge_between_groups_joins_what_pairs_left_apart() -> None:
    rng = np.random.default_rng(4)
    truth = random_poses(6, rng)
    edges = [
        edge(i, j, [between(truth, i, j)], [0.9])
        if (i < 3) == (j < 3)
        else edge(i, j, [random_pose(rng), between(truth, i, j)], [0.2, 0.1])
        for i, j in combinations(range(6), 2)
    ]
    apart = place_scans(6, edges)
    assert apart.groups == ((0, 1, 2), (3, 4, 5))
    right = edge(0, 3, [between(truth, 0, 3), random_pose(rng)], [0.85, 0.1])
    joined = place_scans(6, [*edges, right], start=apart)
    assert joined.groups == (tuple(range(6)),)
    for scan in range(6):
        angle, moved = errors(joined.T_group_scan[scan], between(truth, 0, scan))
        assert angle < 0.1
        assert moved < 1e-6
    assert joined.chosen[-1] == 0
    # Doubt alone joins nothing, and what stood stays.
    doubted = edge(0, 3, [between(truth, 0, 3)], [0.3])
    assert place_scans(6, [*edges, doubted], start=apart).groups == apart.groups


def test_a_registration_of_a_pair_holds_its_two_scans() -> None:
    result = Registration(
        np.eye(4), 0.9, (0.5, 0.5), (), None, np.zeros((0, 2), dtype=np.int64), np.zeros(0),
        np.eye(6), {"total": 0.0}, "any",
    )  # fmt: skip
    assert edge_of(4, 7, result).sides == ((4,), (7,))
