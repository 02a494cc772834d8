"""The figures of run folders: error curves, risk–coverage curves, reliability."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from fullturn.evaluation import metrics, paper
from fullturn.evaluation.folders import PairRows, SetResult, read_pairs
from fullturn.viz.curves import draw_error_curves, draw_risk_coverage

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_pictures(sets: Sequence[SetResult]) -> dict[str, Figure]:
    """By file stem: "curves", and "risk_coverage" where a method states probabilities.

    Sets whose run folder holds no rows of pairs are left out; {} where none does.

    Raises:
        DependencyError: matplotlib is missing.
        ReadError: a table of pairs is damaged.
    """
    rows: dict[str, dict[str, PairRows]] = {}
    for result in sets:
        rows[result.name] = {
            method: one
            for method in result.methods
            if (one := read_pairs(result, method)) is not None
        }
    figures: dict[str, Figure] = {}
    errors = {
        name: {method: one.rotation_error_deg for method, one in found.items()}
        for name, found in rows.items()
    }
    if any(len(one) for found in errors.values() for one in found.values()):
        published = {name: mean for name in rows if (mean := _published_mean(name)) is not None}
        figures["curves"] = draw_error_curves(errors, published=published)
    stated: dict[str, dict[str, tuple[np.ndarray, np.ndarray]]] = {}
    for name, found in rows.items():
        for method, one in found.items():
            if one.probability is not None:
                stated.setdefault(name, {})[method] = (one.probability, one.success)
    if stated:
        risk = {
            name: {method: metrics.risk_coverage(*one) for method, one in found.items()}
            for name, found in stated.items()
        }
        pooled = {}
        for method in dict.fromkeys(method for found in stated.values() for method in found):
            parts = [found[method] for found in stated.values() if method in found]
            probability, success = (np.concatenate(part) for part in zip(*parts, strict=True))
            pooled[method] = metrics.reliability(probability, success)
        figures["risk_coverage"] = draw_risk_coverage(risk, pooled)
    return figures


def _published_mean(name: str) -> tuple[str, float] | None:
    best = paper.best_row(name)
    value = None if best is None else best.figures[name]["rotation_error_deg"].value
    return None if value is None else (paper.METHOD, value)
