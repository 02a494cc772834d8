"""The curves of a run: loss by step, and rotation errors on the validation pairs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fullturn.errors import InputError
from fullturn.training.log import SCORES, STEPS, read_log
from fullturn.viz.canvas import new_figure
from fullturn.viz.curves import COLORS, save_curves
from fullturn.viz.figures import INK, MUTED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BINS = 300  # as many means stand for all steps of a long run


def save_loss_curves(path: Path, out: Path, *, title: str) -> None:
    """Draw the logs of the run folder `out`; the suffix of `path` chooses PNG, PDF, SVG or JPEG.

    Raises:
        DependencyError: matplotlib is missing.
        InputError: the run has no step.
    """
    save_curves(path, draw_loss_curves(out, title=title))


def draw_loss_curves(out: Path, *, title: str) -> Figure:
    """Two panels: each loss by step, and the mean and median error by step."""
    rows = read_log(out / STEPS)
    if not rows:
        raise InputError(f"expected at least one step in {out / STEPS}, found none; train first")
    figure = new_figure(figsize=(9.2, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    names = [n for n in rows[0] if n not in ("step", "pairs", "rate", "gradient", "seconds")]
    # A single loss with weight 1 is the sum, too.
    names = [n for n in names if n == "loss" or len(names) > 2]
    step = _binned([float(row["step"]) for row in rows])
    for color, name in zip(COLORS, names, strict=False):
        left.plot(
            step, _binned([float(row[name]) for row in rows]), color=color, lw=1.4, label=name
        )
    _finish(left, "Loss")
    scores = read_log(out / SCORES)
    for color, name in zip(COLORS, ("mean", "median"), strict=False):
        values = [float(row[f"{name}_deg"]) for row in scores]
        at = [float(row["step"]) for row in scores]
        right.plot(at, values, color=color, lw=1.4, marker="o", ms=3, label=name)
    _finish(right, "Rotation error on validation pairs, °")
    figure.suptitle(title, x=0.01, ha="left", color=INK, fontsize=11)
    return figure


def _binned(values: list[float]) -> np.ndarray:
    parts = np.array_split(np.array(values), min(_BINS, len(values)))
    return np.array([part.mean() for part in parts])


def _finish(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", color=INK, fontsize=10)
    axes.set_xlabel("step", color=MUTED, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("#b3bac2")
    drawn = [value for line in axes.lines for value in np.asarray(line.get_ydata(), dtype=float)]
    if drawn and min(drawn) > 0.0:
        axes.set_yscale("log")
        # Plain numbers, also between powers of ten.
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("{x:g}" if max(drawn) < 30.0 * min(drawn) else "")
    axes.tick_params(which="both", colors=MUTED, labelsize=8)
    if drawn:
        axes.legend(frameon=False, fontsize=8)
