from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from run_pairs import listed_pairs

from fullturn.data.pair import Pair
from fullturn.evaluation.predict import Prediction
from fullturn.evaluation.score import Score, ScoredPair, summarize


def turned(T: np.ndarray, angle_deg: float) -> np.ndarray:
    """The pose after a turn about the target's z axis, through the origin."""
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    turn = np.eye(4)
    turn[:2, :2] = [[c, -s], [s, c]]
    return turn @ T


@pytest.fixture
def pair() -> Pair:
    return listed_pairs(1).pair(0)


def score(pair: Pair, T: np.ndarray, **more: object) -> Score:
    return ScoredPair(pair, index=0).score(Prediction(T, **more))  # type: ignore[arg-type]


def test_the_truth_is_right_in_every_way(pair: Pair) -> None:
    row = score(pair, pair.T_target_source, success_probability=0.7)
    assert row.success
    assert row.any_success
    assert row.geometric_success
    assert row.rotation_error_deg == pytest.approx(0.0, abs=1e-9)
    assert row.success_probability == 0.7


def test_an_alternative_may_be_right(pair: Pair) -> None:
    wrong = turned(pair.T_target_source, 90.0)
    row = score(pair, wrong, alternatives=(wrong, pair.T_target_source))
    assert not row.success
    assert row.any_success
    assert row.alternatives == 2
    assert row.rotation_error_deg == pytest.approx(90.0)


def test_a_symmetric_pose_succeeds_geometrically() -> None:
    # A square has four poses that fit; one of them is the true one.
    square = np.array([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (0, 0.1)])
    pair = Pair(square, square, np.eye(4), "square")
    row = score(pair, turned(np.eye(4), 90.0))
    assert (row.success, row.geometric_success) == (False, True)
    assert not score(pair, turned(np.eye(4), 45.0)).geometric_success


def test_a_failure_is_no_success_even_where_the_identity_is_right() -> None:
    cloud = np.random.default_rng(0).normal(size=(20, 3))
    row = score(Pair(cloud, cloud, np.eye(4), "at rest"), np.eye(4), error="it crashed")
    assert (row.success, row.geometric_success, row.any_success) == (False, False, False)
    summary = summarize([row], seed=0)
    assert summary["errors"] == summary["n"] == 1
    assert summary["recall_5deg"] == summary["recall_0.1_distance"] == summary["success"] == 0.0
    assert summary["mean_deg"] == 0.0


def test_an_unrelated_pair_has_no_error_but_a_probability(pair: Pair) -> None:
    stranger = dataclasses.replace(pair, related=False)
    right = score(pair, pair.T_target_source, success_probability=1.0)
    sure = score(stranger, pair.T_target_source, success_probability=0.8)
    unsure = score(stranger, pair.T_target_source, success_probability=0.2)
    assert sure.rotation_error_deg is None
    assert not sure.success
    summary = summarize([right, sure, unsure], seed=0)
    assert (summary["n"], summary["unrelated"]) == (3, 2)
    assert summary["success"] == summary["recall_5deg"] == 1.0
    assert summary["unrelated_at_most_0.2"] == 0.5
    assert summary["brier"] == pytest.approx((0.0 + 0.64 + 0.04) / 3)


def test_summary_counted_by_hand(pair: Pair) -> None:
    angles = [0.05, 0.5, 3.0, 8.0, 90.0]
    rows = [
        score(pair, turned(pair.T_target_source, angle), success_probability=p)
        for angle, p in zip(angles, (0.9, 0.8, 0.7, 0.6, 0.5), strict=True)
    ]
    summary = summarize(rows, seed=0)
    assert summary["mean_deg"] == pytest.approx(np.mean(angles))
    assert summary["median_deg"] == pytest.approx(3.0)
    recalls = [summary[f"recall_{x}deg"] for x in (0.1, 1, 5, 10)]
    assert recalls == pytest.approx([0.2, 0.4, 0.6, 0.8])
    low, high = summary["mean_deg_interval"]
    assert low < np.mean(angles) < high
    assert summary["mean_probability"] == pytest.approx(0.7)
    # The most probable answer is right; all answered, as many fail as there are failures.
    assert summary["risk_coverage"]["0.2"] == 0.0
    assert summary["risk_coverage"]["1.0"] == pytest.approx(1 - summary["success"])


def test_without_probabilities_nothing_is_said_of_them(pair: Pair) -> None:
    summary = summarize([score(pair, pair.T_target_source)], seed=0)
    assert "mean_probability" not in summary
    assert "calibration_error" not in summary


def test_a_failed_pair_counts_as_probability_zero(pair: Pair) -> None:
    rows = [
        score(pair, pair.T_target_source, success_probability=1.0),
        score(pair, np.eye(4), error="it crashed"),
    ]
    assert summarize(rows, seed=0)["mean_probability"] == 0.5
