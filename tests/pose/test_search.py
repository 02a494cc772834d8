"""The search holds the truth, keeps its poses apart and does not depend on frames or order."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import torch
from pose_shapes import pose_error, random_motions, rms_displacement, teapot
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.geometry.cloud import Cloud
from fullturn.pose.search import Finalists, SearchConfig, find_finalists
from fullturn.pose.verify import FEATURES

T_TRUE = random_motions(1, seed=4)[0]
SMALL = SearchConfig(coarse_points=400, verify_points=900, modes=40, finalists=10)


def clouds(n: int = 3000, m: int = 2500, *, order: int | None = None) -> tuple[Cloud, Cloud]:
    """Independent samples of opposite parts of the teapot, each about its own mean."""
    source, target = teapot(n, 1)[0], teapot(m, 2)[0]
    source, target = source[source[:, 1] > -0.3], target[target[:, 1] < 0.3]
    if order is not None:
        rng = np.random.default_rng(order)
        source, target = (x[torch.from_numpy(rng.permutation(len(x)))] for x in (source, target))
    return Cloud(source), Cloud(rigid.apply(T_TRUE, target))


@cache
def found(n: int = 3000, m: int = 2500) -> Finalists:
    return find_finalists(*clouds(n, m), config=SMALL)


def nearest(finalists: Finalists, T: Tensor) -> tuple[float, float]:
    angle, offset = pose_error(finalists.T_target_source, T)
    best = int((angle / 5 + offset / 0.05).argmin())
    return float(angle[best]), float(offset[best])


@pytest.mark.parametrize(("n", "m"), [(3000, 2500), (700, 30_000), (350, 380)])
def test_the_truth_is_among_the_finalists(n: int, m: int) -> None:
    angle, offset = nearest(found(n, m), T_TRUE)
    coarseness = max(1.0, 1000 / min(n, m))
    assert angle < 4.0 * coarseness
    assert offset < 0.04 * coarseness


def test_finalists_are_rigid_measured_and_few() -> None:
    finalists = found()
    T = finalists.T_target_source
    assert T.dtype == torch.float64
    assert 1 <= len(T) <= SMALL.finalists + SMALL.matched_finalists
    R = T[:, :3, :3]
    torch.testing.assert_close(R @ R.mT, torch.eye(3).double().expand_as(R), atol=1e-9, rtol=0)
    torch.testing.assert_close(torch.linalg.det(R), torch.ones(len(T)).double())
    assert finalists.features.shape == (len(T), len(FEATURES))
    assert bool(torch.isfinite(finalists.features).all())
    assert all(seconds >= 0.0 for seconds in finalists.seconds.values())
    assert {"levels", "describe", "match", "hypothesize", "refine", "verify"} <= set(
        finalists.seconds
    )


def test_finalists_differ() -> None:
    source, _ = clouds()
    T = found().T_target_source
    apart = [rms_displacement(T[i], T[j], source.points) for i in range(len(T)) for j in range(i)]
    assert float(np.median(apart)) > 0.1


def test_the_same_clouds_give_the_same_bytes_in_any_order() -> None:
    again = find_finalists(*clouds(), config=SMALL)
    assert torch.equal(again.T_target_source, found().T_target_source)
    assert torch.equal(again.features, found().features)
    mixed = find_finalists(*clouds(order=5), config=SMALL)
    angle, offset = nearest(mixed, found().T_target_source[0])
    assert angle < 1.0
    assert offset < 0.01


def test_the_inputs_are_not_modified() -> None:
    source, target = clouds(600, 500)
    before = source.points.clone(), target.points.clone()
    find_finalists(source, target, config=SMALL)
    assert torch.equal(source.points, before[0])
    assert torch.equal(target.points, before[1])


def test_a_pose_from_elsewhere_is_measured_alike() -> None:
    finalists = found()
    given = finalists.T_target_source[:3]
    again = find_finalists(*clouds(), config=SMALL, given=given)
    torch.testing.assert_close(again.T_target_source[: len(given)], given)
    torch.testing.assert_close(
        again.features[: len(given)], finalists.features[: len(given)], atol=0.02, rtol=0
    )
    torch.testing.assert_close(again.features[len(given) :], finalists.features)


@pytest.mark.parametrize("count", [3, 4, 10, 50])
def test_tiny_clouds_are_searched(count: int) -> None:
    points, _ = teapot(count)
    points = points - points.mean(0)
    finalists = find_finalists(Cloud(points), Cloud(rigid.apply(T_TRUE, points)), config=SMALL)
    assert bool(torch.isfinite(finalists.T_target_source).all())
    assert bool(torch.isfinite(finalists.features).all())


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_very_unlike_clouds_are_searched(scale: float) -> None:
    larger = max(1.0, scale)
    source, target = teapot(3000, 1)[0], teapot(3000, 2)[0]
    finalists = find_finalists(
        Cloud((source - source.mean(0)) / larger),
        Cloud((target - target.mean(0)) * scale / larger),
        config=SMALL,
    )
    assert bool(torch.isfinite(finalists.features).all())
