"""How much handcrafted features change when a cloud is turned, shifted or noisy.

After the preliminary study of Pan, Cai and Liu, "Robust Partial-to-Partial Point Cloud Registration
in a Full Range" (GMCNet). What is measured, and why so, is told in docs/robustness.md.
"""

from __future__ import annotations

import csv
import io
import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.data.shapes import ShapeSource
from fullturn.errors import InputError
from fullturn.evaluation.feature_change import (
    UNITS,
    StudyConfig,
    noise_error,
    pose_similarity,
    unrelated,
)

# A spread below this, in radii, rad or percent, is none.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Row:
    """One point of one curve: the mean over the shapes, and where the middle 80 % of them lie."""

    panel: str
    feature: str
    x: float  # degrees, or sigma in radii; nan where a feature has one value
    value: float
    low: float
    high: float


def study_robustness(
    shapes: ShapeSource,
    *,
    count: int,
    seed: int = 0,
    config: StudyConfig | None = None,
    on_shape: Callable[[int, str], None] = lambda number, name: None,
) -> list[Row]:
    """Study `count` shapes, or all; where there are more, they are spread evenly over the source.

    Shape i draws from (seed, i) alone. `on_shape` is told how many are done, and the name of the
    last one.

    Raises:
        InputError: no shapes asked for, more neighbors than points, or a shape that is one point.
    """
    if count < 1:
        raise InputError(f"count must be at least 1, got {count}")
    config = config or StudyConfig()
    if config.neighbors > config.points:
        raise InputError(
            f"neighbors: expected at most the {config.points} points of a shape, got "
            f"{config.neighbors}; ask for fewer"
        )
    chosen = np.unique(np.linspace(0, len(shapes) - 1, min(count, len(shapes))).round().astype(int))
    found: defaultdict[tuple[str, str], list[list[float]]] = defaultdict(list)
    for number, index in enumerate(chosen.tolist(), start=1):
        rng = np.random.default_rng([seed, index])
        read = shapes.points(index, config.points, rng)
        read = read + config.jitter * rng.standard_normal(read.shape)
        points = to_unit_ball(torch.from_numpy(read))
        limit = config.max_translation
        translation = torch.from_numpy(rng.uniform(-limit, limit, 3))
        for curves in (
            pose_similarity(points, translation, config),
            noise_error(points, rng, config),
            unrelated(points, rng, config),
        ):
            for key, values in curves.items():
                found[key].append(values)
        on_shape(number, shapes.name(index))
    return _summarize({key: np.array(values) for key, values in found.items()}, config)


def to_unit_ball(points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """The cloud with its mean at the origin and its farthest point at distance 1."""
    centered = points - points.mean(0)
    radius = torch.linalg.vector_norm(centered, dim=-1).max()
    if not radius > 0:
        raise InputError("expected a cloud of at least two distinct points, all of them coincide")
    return centered / radius


def by_panel(rows: Iterable[Row]) -> dict[str, dict[str, Float[np.ndarray, "4 m"]]]:
    """Curves of each panel and feature: x, value, low and high."""
    lines: defaultdict[str, defaultdict[str, list[list[float]]]]
    lines = defaultdict(lambda: defaultdict(list))
    for row in rows:
        lines[row.panel][row.feature].append([row.x, row.value, row.low, row.high])
    return {
        panel: {feature: np.array(line).T for feature, line in features.items()}
        for panel, features in lines.items()
    }


def to_csv(rows: Iterable[Row]) -> str:
    """The table with the columns panel, feature, x, value, low, high; 6 significant digits."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["panel", "feature", "x", "value", "low", "high"])
    for row in rows:
        numbers = (row.x, row.value, row.low, row.high)
        cells = ["" if math.isnan(number) else f"{number:.6g}" for number in numbers]
        writer.writerow([row.panel, row.feature, *cells])
    return text.getvalue()


def _summarize(
    found: Mapping[tuple[str, str], Float[np.ndarray, "shapes m"]], config: StudyConfig
) -> list[Row]:
    """Mean and range over the shapes; adds the errors in units of what tells points apart."""
    panels = dict(found)
    for panel, label in found:
        if panel in ("noise", "noise anew"):
            panels[f"{panel}, relative", label] = _relative(found, panel, label)
    axes = {"rotation": config.angles_deg, "se3": config.angles_deg}
    rows: list[Row] = []
    for (panel, label), values in sorted(panels.items(), key=lambda item: item[0][0]):
        x = axes.get(panel, config.noise_sigmas if panel.startswith("noise") else (math.nan,))
        low, high = np.quantile(values, [0.1, 0.9], axis=0)
        columns = (x, values.mean(axis=0), low, high)
        for numbers in zip(*columns, strict=True):
            rows.append(Row(panel, label, *map(float, numbers)))
    return rows


def _relative(
    found: Mapping[tuple[str, str], np.ndarray], panel: str, label: str
) -> Float[np.ndarray, "shapes m"]:
    """Errors over the mean difference of two random points, unit by unit, channels weighed alike.

    nan where the points of all shapes are alike, as a plane's are to PPF.
    """
    units = UNITS.get(label, {})
    if len(units) > 1:
        labels = {f"{label} {unit}": part.stop - part.start for unit, part in units.items()}
    else:
        labels = {label: 1}
    total = 0
    for name, channels in labels.items():
        spread = found["spread", name].mean()
        total = total + channels * found[panel, name] / (spread if spread > _ROUNDING else math.nan)
    return np.asarray(total) / sum(labels.values())
