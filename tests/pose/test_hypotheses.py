"""Agreement, seeds, scores and distances of poses against their definitions."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from pose_shapes import pose_error, random_motions, rms_displacement, teapot
from scipy.spatial import cKDTree
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.matching.correspondence import Matches
from fullturn.pose.grid import NearestGrid
from fullturn.pose.hypotheses import (
    MatchedPoints,
    compatibility,
    distinct,
    matched_share,
    pose_distances,
    score_poses,
    seeded_poses,
)


def matched(
    count: int, *, wrong: float, noise: float = 0.0, seed: int = 0
) -> tuple[Matches, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Matches of which a share is wrong; both clouds with normals; the true pose."""
    rng = np.random.default_rng(seed)
    source, source_normals = teapot(count, seed)
    T_true = random_motions(1, seed=seed + 1)[0]
    target = rigid.apply(T_true, source) + noise * torch.from_numpy(rng.normal(size=(count, 3)))
    # Normals come without a sign.
    signs = torch.from_numpy(rng.choice([-1.0, 1.0], (count, 1)))
    target_normals = source_normals @ T_true[:3, :3].mT * signs
    partner = np.arange(count)
    spoiled = rng.permutation(count)[: int(wrong * count)]
    partner[spoiled] = rng.integers(0, count, len(spoiled))
    matches = Matches(
        torch.arange(count), torch.from_numpy(partner), torch.ones(count, dtype=source.dtype)
    )
    return matches, source, target, source_normals, target_normals, T_true


@pytest.mark.parametrize("max_rotation_rad", [None, 0.7, 3.5])
def test_compatibility_by_hand(max_rotation_rad: float | None) -> None:
    matches, source, target, source_normals, target_normals, _ = matched(40, wrong=0.5, noise=0.02)
    found = compatibility(
        MatchedPoints.of(matches, source, target, source_normals, target_normals),
        length_tolerance=0.3,
        max_rotation_rad=max_rotation_rad,
    )
    too_far = 0
    for a, b in np.ndindex(40, 40):
        i, j, k, m = (int(x) for x in (*matches.source[[a, b]], *matches.target[[a, b]]))
        here, there = float((source[i] - source[j]).norm()), float((target[k] - target[m]).norm())
        angles = abs(float(source_normals[i] @ source_normals[j])) - abs(
            float(target_normals[k] @ target_normals[m])
        )
        expected = max(0.0, 1 - ((here - there) / 0.3) ** 2) * max(0.0, 1 - (angles / 0.4) ** 2)
        if min(here, there) <= 0.3:
            expected = 0.0
        elif max_rotation_rad is not None:
            lines = (source[i] - source[j]).double(), (target[k] - target[m]).double()
            turn = float(torch.acos(torch.cosine_similarity(*lines, dim=0)))
            too_far += turn > max_rotation_rad and expected > 0.0
            expected *= turn <= max_rotation_rad
        assert float(found[a, b]) == pytest.approx(expected, abs=1e-9)
    assert (too_far > 0) == (max_rotation_rad == 0.7)


def test_compatibility_is_symmetric_and_no_motion_changes_it() -> None:
    matches, *clouds, T_true = matched(80, wrong=0.6, noise=0.01)
    source, target, source_normals, target_normals = clouds
    plain = compatibility(MatchedPoints.of(matches, *clouds), length_tolerance=0.2)
    torch.testing.assert_close(plain, plain.mT)
    assert float(plain.min()) >= 0.0
    assert float(plain.max()) <= 1.0
    assert float(plain.diagonal().max()) == 0.0
    g, h = random_motions(2, seed=5, length=3.0)
    moved = compatibility(
        MatchedPoints.of(
            matches,
            rigid.apply(g, source),
            rigid.apply(h, target),
            -source_normals @ g[:3, :3].mT,
            target_normals @ h[:3, :3].mT,
        ),
        length_tolerance=0.2,
    )
    torch.testing.assert_close(moved, plain, atol=1e-9, rtol=0)
    assert torch.equal(source, clouds[0])
    right = compatibility(
        MatchedPoints.of(
            Matches(matches.source, matches.source, matches.similarity),
            source,
            rigid.apply(T_true, source),
            source_normals,
            source_normals @ T_true[:3, :3].mT,
        ),
        length_tolerance=0.2,
    )
    far = torch.cdist(source, source) > 0.21
    assert float(right[far].min()) > 1 - 1e-9


@pytest.mark.parametrize("wrong", [0.0, 0.5, 0.7])
def test_seeds_find_the_pose_among_wrong_matches(wrong: float) -> None:
    matches, *clouds, T_true = matched(200, wrong=wrong, noise=0.005, seed=2)
    points = MatchedPoints.of(matches, *clouds)
    agreement = compatibility(points, length_tolerance=0.08)
    T = seeded_poses(points, agreement, companions=12)
    assert T.shape == (200, 4, 4)
    R = T[:, :3, :3]
    torch.testing.assert_close(R @ R.mT, torch.eye(3).double().expand_as(R), atol=1e-9, rtol=0)
    right = matches.source == matches.target
    angle, offset = pose_error(T, T_true)
    good = (angle < 4.0) & (offset < 0.05)
    assert float(good[right].double().mean()) > 0.7
    # Whoever shares most with others is right.
    best = agreement.sum(1).topk(10).indices
    assert bool(good[best].all())


def test_few_matches_give_finite_poses() -> None:
    for count in (1, 2, 3, 5):
        matches, *clouds, _ = matched(count, wrong=0.0, seed=3)
        points = MatchedPoints.of(matches, *clouds)
        T = seeded_poses(points, compatibility(points, length_tolerance=0.05), companions=6)
        assert T.shape == (count, 4, 4)
        assert bool(torch.isfinite(T).all())


def test_the_share_of_matches_that_a_pose_brings_together() -> None:
    matches, source, target, source_normals, target_normals, T_true = matched(60, wrong=0.4)
    # Two matches of every point, one of them with the target's normal against it.
    twice = Matches(
        torch.cat([matches.source, matches.source.flip(0)]),
        torch.cat([matches.target, matches.target]),
        torch.ones(120).double(),
    )
    clouds = (source, target, source_normals, target_normals)
    T = torch.cat([T_true[None], random_motions(130, seed=4)])
    share = matched_share(MatchedPoints.of(twice, *clouds), T, truncation=0.4)
    for pose, found in list(zip(T, share, strict=True))[:20]:
        best, moved = [0.0] * 60, rigid.apply(pose, source)
        for i, j in zip(twice.source.tolist(), twice.target.tolist(), strict=True):
            distance = float((moved[i] - target[j]).norm())
            cosine = float(pose[:3, :3] @ source_normals[i] @ target_normals[j])
            best[i] = max(best[i], max(0.0, 1 - (distance / 0.4) ** 2) * max(0.0, cosine))
        assert float(found) == pytest.approx(np.mean(best), abs=1e-9)
    assert int(share.argmax()) == 0


@pytest.mark.parametrize("count", [5, 300])
def test_scores_agree_with_brute_force(count: int) -> None:
    points, normals = teapot(1500)
    cell, truncation = 0.015, 0.09
    grid = NearestGrid(points, normals, cell=cell, band=0.13)
    some, _ = teapot(120, 7)
    T = random_motions(count, seed=8, angle_deg=40.0, length=0.1)
    T[0] = torch.eye(4)
    area = torch.from_numpy(np.random.default_rng(12).uniform(0.1, 10, len(some)))
    scores = score_poses(some, area.to(some), grid, T, truncation=truncation)
    tree = cKDTree(points.numpy())
    for pose, score in zip(T[:20], scores, strict=False):
        distance, _ = tree.query(rigid.apply(pose, some).numpy())
        share = np.clip(1 - (distance / truncation) ** 2, 0, None)
        expected = np.average(share, weights=area.numpy())
        # A point found in place of the nearest is farther, never nearer.
        assert -0.06 < float(score) - expected < 1e-9
    assert int(scores.argmax()) == 0


def test_distances_are_rms_displacements() -> None:
    points, _ = teapot(500)
    points = points[points[:, 0] > -0.2] * torch.tensor([1.0, 0.7, 0.3]) + 0.4
    T = random_motions(12, seed=9)
    apart = pose_distances(T, points)
    assert apart.shape == (12, 12)
    for a, b in np.ndindex(12, 12):
        assert float(apart[a, b]) == pytest.approx(rms_displacement(T[a], T[b], points), abs=1e-7)


@pytest.mark.parametrize("kind", ["plane", "line", "one point"])
def test_distances_on_flat_clouds(kind: str) -> None:
    points, _ = teapot(50)
    flat = {
        "plane": points * torch.tensor([1.0, 1.0, 0.0]),
        "line": points[:, :1] * torch.tensor([1.0, 2.0, 3.0]),
        "one point": points[:1].expand(50, 3),
    }[kind].double()
    T = random_motions(2, seed=10)
    apart = pose_distances(T, flat)[0, 1]
    assert float(apart) == pytest.approx(rms_displacement(T[0], T[1], flat), abs=1e-7)


@pytest.mark.parametrize("limit", [1, 7, 1000])
@pytest.mark.parametrize("radius", [0.0, 0.5, 100.0])
def test_distinct_by_hand(limit: int, radius: float) -> None:
    rng = np.random.default_rng(11)
    coordinates = torch.from_numpy(rng.normal(size=(150, 3)))
    scores = torch.from_numpy(rng.uniform(size=150))
    kept: list[int] = []
    for i in np.argsort(-scores.numpy()):
        away = all(float((coordinates[i] - coordinates[j]).norm()) >= radius for j in kept)
        if away and len(kept) < limit:
            kept.append(int(i))
    apart = torch.cdist(coordinates, coordinates)
    assert distinct(apart, scores, radius=radius, limit=limit).tolist() == kept


def test_of_equal_scores_the_first_is_kept() -> None:
    assert distinct(torch.zeros(5, 5), torch.ones(5), radius=0.1, limit=3).tolist() == [0]
