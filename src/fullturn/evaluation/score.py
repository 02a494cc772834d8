"""Score: how good one answer is, and what all answers of a method come to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from fullturn.data.pair import Pair
from fullturn.evaluation import metrics
from fullturn.evaluation.predict import Prediction

_DISTANCES = ("mean_point_distance", "rmse", "rmse_paper")
_CERTAIN = 0.9  # from this probability on, an answer counts as certain


@dataclass(frozen=True)
class Score:
    """One row of the results. Of an unrelated pair, no pose is right and no error is defined."""

    index: int
    name: str
    group: str
    related: bool
    rotation_error_deg: float | None
    translation_error: float | None
    mean_point_distance: float | None
    rmse: float | None
    rmse_paper: float | None
    success: bool
    geometric_success: bool
    any_success: bool  # of the answer or one of its alternatives
    success_probability: float | None
    alternatives: int
    error: str | None


class ScoredPair:
    """A pair, scored against any number of answers; what depends on the truth alone is kept."""

    def __init__(self, pair: Pair, *, index: int, group: str = "") -> None:
        self.pair, self.index, self.group = pair, index, group

    @cached_property
    def _fit_of_true(self) -> float:
        return metrics.fit_distance(self.pair.T_target_source, self.pair.source, self.pair.target)

    def score(self, answer: Prediction) -> Score:
        """All metrics of an answer. A method that failed gets the errors of the identity and no
        success, even where the identity happens to be right."""
        pair, found, true = self.pair, answer.T_target_source, self.pair.T_target_source
        counts = pair.related and answer.error is None
        errors: dict[str, float | None] = {
            "rotation_error_deg": float(metrics.rotation_error_deg(found, true)),
            "translation_error": float(metrics.translation_error(found, true)),
            "mean_point_distance": metrics.mean_point_distance(found, true, pair.source),
            "rmse": metrics.rmse(found, true, pair.source),
            "rmse_paper": metrics.rmse_paper(found, true, pair.source),
        }
        success = counts and metrics.pose_success(found, true, pair.source)
        return Score(
            index=self.index,
            name=pair.name,
            group=self.group,
            related=pair.related,
            **(errors if pair.related else dict.fromkeys(errors)),
            success=success,
            geometric_success=counts
            and metrics.geometric_success(
                found, true, pair.source, pair.target, fit_of_true=self._fit_of_true
            ),
            any_success=counts
            and (
                success
                or any(metrics.pose_success(T, true, pair.source) for T in answer.alternatives)
            ),
            success_probability=answer.success_probability,
            alternatives=len(answer.alternatives),
            error=answer.error,
        )


def summarize(rows: Sequence[Score], *, seed: int) -> dict[str, Any]:
    """Means, medians, shares and calibration over all rows, failures included.

    Errors and shares are over the related pairs; probabilities are judged on all.
    """
    related = [row for row in rows if row.related]
    summary: dict[str, Any] = {"n": len(rows), "unrelated": len(rows) - len(related)}
    if related:
        summary |= _accuracy(related, rng=np.random.default_rng(seed))
    summary["errors"] = sum(row.error is not None for row in rows)
    stated = [row for row in rows if row.success_probability is not None]
    if stated:
        summary |= _honesty(rows)
    return summary


def _accuracy(rows: Sequence[Score], *, rng: np.random.Generator) -> dict[str, Any]:
    """Errors and shares; means, and the shares that are quoted most, with 95 % intervals."""
    failed = np.array([row.error is not None for row in rows])
    summary: dict[str, Any] = {}

    def mean(name: str, values: Float[np.ndarray, " n"]) -> None:
        summary[name] = float(values.mean())
        summary[f"{name}_interval"] = metrics.bootstrap_interval(values, rng)

    angle = _column(rows, "rotation_error_deg")
    mean("mean_deg", angle)
    summary["median_deg"] = float(np.median(angle))
    # A failure is no success at any threshold, though the identity may be near the truth.
    within = np.where(failed, np.inf, angle)
    for threshold in (0.1, 1, 10):
        summary[f"recall_{threshold}deg"] = metrics.recall(within, threshold)
    mean("recall_5deg", (within < 5.0).astype(np.float64))
    distance = np.where(failed, np.inf, _column(rows, "mean_point_distance"))
    summary["recall_0.1_distance"] = metrics.recall(distance, 0.1)
    for key in ("translation_error", *_DISTANCES):
        values = _column(rows, key)
        mean(f"mean_{key}", values)
        summary[f"median_{key}"] = float(np.median(values))
    for key in ("success", "any_success", "geometric_success"):
        mean(key, _column(rows, key))
    return summary


def _honesty(rows: Sequence[Score]) -> dict[str, Any]:
    """How well the probabilities fit. A failed pair says nothing: it counts as probability 0."""
    probability = np.array([row.success_probability or 0.0 for row in rows])
    success: Bool[np.ndarray, " n"] = np.array([row.success for row in rows])
    coverage, risk = metrics.risk_coverage(probability, success)
    summary: dict[str, Any] = {
        "mean_probability": float(probability.mean()),
        "calibration_error": metrics.expected_calibration_error(probability, success),
        "brier": metrics.brier(probability, success),
        "risk_coverage": {
            f"{level:.1f}": float(risk[np.searchsorted(coverage, level - 1e-12)])
            for level in np.arange(1, 11) / 10
        },
    }
    certain = probability >= _CERTAIN
    summary["certain"] = float(certain.mean())
    if certain.any():
        summary["certain_right"] = float(success[certain].mean())
    unrelated = np.array([not row.related for row in rows])
    if unrelated.any():
        summary["unrelated_at_most_0.2"] = float(np.mean(probability[unrelated] <= 0.2))
    return summary


def _column(rows: Sequence[Score], key: str) -> Float[np.ndarray, " n"]:
    return np.array([getattr(row, key) for row in rows], dtype=np.float64)
