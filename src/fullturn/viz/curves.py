"""How good and how honest methods are, over many pairs: curves for papers and pages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from fullturn.errors import InputError
from fullturn.viz.canvas import new_figure
from fullturn.viz.figures import INK, MUTED, write_figure

if TYPE_CHECKING:
    from os import PathLike

    from jaxtyping import Float
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Told apart with any color vision (Okabe and Ito), yellow left out for its contrast; in this order.
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#000000", "#e69f00")
DASHES = ("-", (0, (5, 1.5)), (0, (1, 1)))  # the next round of colors is dashed, then dotted
ANGLES_DEG = (0.01, 180.0)
MARKED_DEG = 5.0  # where the labels' shares are read
PANEL_INCHES = (4.6, 2.9)


def draw_error_curves(
    sets: Mapping[str, Mapping[str, Float[np.ndarray, " n"]]],
    *,
    published: Mapping[str, tuple[str, float]] | None = None,
) -> Figure:
    """Per set, the share of pairs below each rotation error, from 0.01° to 180°.

    `sets` holds errors in degrees by set and method, infinite for a failure; `published` a name and
    a mean to mark, by set. Each label gives the share below 5°.

    Raises:
        DependencyError: matplotlib is missing.
        InputError: there is nothing to draw.
    """
    sets = {name: {m: e for m, e in part.items() if len(e)} for name, part in sets.items()}
    sets = {name: part for name, part in sets.items() if part}
    styles = _styles(sets.values())
    figure, panels = _panels(len(sets))
    for axes, (name, methods) in zip(panels, sets.items(), strict=True):
        labels = []
        for method, errors in methods.items():
            ordered = np.clip(np.sort(errors), ANGLES_DEG[0], None)
            shares = np.arange(1, len(ordered) + 1) / len(ordered)
            # A failure lies beyond the right end, so the curve stays below 100 %.
            drawn = ordered <= ANGLES_DEG[1]
            x = [ANGLES_DEG[0], *ordered[drawn], ANGLES_DEG[1]]
            y = [0.0, *shares[drawn], float(drawn.mean())]
            axes.step(x, y, where="post", lw=1.7, **styles[method])
            share = float((errors < MARKED_DEG).mean())
            labels.append((share, f"{method} {100 * share:.0f} %", styles[method]["color"]))
        mean = (published or {}).get(name)
        if mean is not None:
            axes.axvline(max(mean[1], ANGLES_DEG[0]), color=MUTED, lw=1.0, ls=(0, (2, 2)))
            _beside(axes, f"{mean[0]}: mean {mean[1]:g}°", x=max(mean[1], ANGLES_DEG[0]))
        axes.axvline(MARKED_DEG, color="#dfe3e8", lw=1.0, zorder=0)
        axes.set_xscale("log")
        axes.set_xlim(*ANGLES_DEG)
        ticks = (0.01, 0.1, 1.0, MARKED_DEG, 30.0, 180.0)
        axes.set_xticks(ticks, [f"{tick:g}°" for tick in ticks], minor=False)
        axes.minorticks_off()
        _share_axis(axes, name)
        _label_right(axes, labels)
    _title(figure, "Share of pairs below a rotation error; labels give the share below 5°")
    return figure


def draw_risk_coverage(
    sets: Mapping[str, Mapping[str, tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]]],
    reliability: Mapping[
        str,
        tuple[Float[np.ndarray, " bins"], Float[np.ndarray, " bins"], Float[np.ndarray, " bins"]],
    ],
) -> Figure:
    """Per set, the share of wrong answers among the most probable ones; last, the reliability.

    `sets` holds (coverage, risk) by set and method, `reliability` (mean probability, share right,
    pairs) of each bin by method, over all sets. Labels give the risk of answering every pair.

    Raises:
        DependencyError: matplotlib is missing.
        InputError: there is nothing to draw.
    """
    sets = {name: part for name, part in sets.items() if part}
    styles = _styles([*sets.values(), reliability])
    figure, panels = _panels(len(sets) + 1 if sets else 0)
    for axes, (name, methods) in zip(panels, sets.items(), strict=False):
        labels = []
        for method, (coverage, risk) in methods.items():
            axes.step(coverage, risk, where="post", lw=1.7, **styles[method])
            text = f"{method} {100 * risk[-1]:.0f} %"
            labels.append((float(risk[-1]), text, styles[method]["color"]))
        axes.set_xlim(0.0, 1.0)
        axes.set_xticks((0.0, 0.5, 1.0), ("0 %", "50 %", "100 % answered"))
        _share_axis(axes, f"{name}: share wrong")
        _label_right(axes, labels)
    _draw_reliability(panels[-1], reliability, styles)
    _title(figure, "Wrong answers among the most probable ones, and what the probability is worth")
    return figure


def save_curves(path: str | PathLike[str], figure: Figure, *, dpi: int = 130) -> None:
    """Write a figure; the suffix chooses PNG, PDF, SVG or JPEG, and equal figures give equal bytes.

    Raises:
        WriteError: another suffix, or the place cannot be written.
    """
    write_figure(path, lambda: figure, dpi=dpi)


def _draw_reliability(
    axes: Axes,
    reliability: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]],
    styles: Mapping[str, dict],
) -> None:
    axes.plot([0, 1], [0, 1], color=MUTED, lw=1.0, ls=(0, (2, 2)))
    labels = []
    for method, (said, right, pairs) in reliability.items():
        color = styles[method]["color"]
        axes.plot(said, right, lw=1.2, **styles[method])
        # The area of a dot is the share of the pairs in its bin.
        axes.scatter(
            said, right, s=12.0 + 150.0 * pairs / pairs.sum(), color=color, zorder=3, clip_on=False
        )
        labels.append((float(right[-1]), method, color))
    axes.set_xlim(0.0, 1.0)
    axes.set_xticks((0.0, 0.5, 1.0), ("0 %", "50 %", "100 % said"))
    _share_axis(axes, "All of these pairs: share right by what was said")
    _label_right(axes, labels)


def _styles(sets: Iterable[Mapping[str, object]]) -> dict[str, dict]:
    """A line style per method, in the order of their first appearance."""
    methods = dict.fromkeys(method for part in sets for method in part)
    return {
        method: {
            "color": COLORS[number % len(COLORS)],
            "linestyle": DASHES[number // len(COLORS) % len(DASHES)],
        }
        for number, method in enumerate(methods)
    }


def _panels(count: int) -> tuple[Figure, Sequence[Axes]]:
    figure = new_figure()
    if count == 0:
        raise InputError("expected at least one set with pairs to draw, got none; pass one")
    columns = 1 if count == 1 else 2 if count in (2, 4) else 3
    rows = math.ceil(count / columns)
    width, height = PANEL_INCHES
    inches = height * rows + 0.5
    figure.set_size_inches(width * columns, inches)
    grid = {"left": 0.5 / (width * columns), "right": 1.0 - 1.25 / (width * columns)}
    grid |= {"bottom": 0.35 / inches, "top": 1.0 - 0.85 / inches, "wspace": 0.48, "hspace": 0.38}
    spots = figure.subplots(rows, columns, squeeze=False, gridspec_kw=grid).ravel()
    for axes in spots[count:]:
        axes.set_visible(False)
    return figure, list(spots[:count])


def _share_axis(axes: Axes, title: str) -> None:
    axes.set_ylim(-0.01, 1.01)
    axes.set_yticks((0.0, 0.5, 1.0), ("0", "50 %", "100 %"))
    axes.tick_params(colors=MUTED, labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("#b3bac2")
    axes.set_title(title, loc="left", color=INK, fontsize=10)


def _label_right(axes: Axes, labels: Sequence[tuple[float, str, str]]) -> None:
    """Names at the right edge, each near the height of its number, none upon another."""
    gap = 0.085
    order = sorted(range(len(labels)), key=lambda i: (labels[i][0], -i))
    heights = np.array([labels[i][0] for i in order])
    for k in range(1, len(heights)):
        heights[k] = max(heights[k], heights[k - 1] + gap)
    # Pushed past the top: the whole stack comes down as far as it must.
    for k in range(len(heights) - 1, -1, -1):
        limit = 1.0 if k == len(heights) - 1 else heights[k + 1] - gap
        heights[k] = min(heights[k], limit)
    for height, i in zip(heights, order, strict=True):
        _, text, color = labels[i]
        axes.annotate(
            text,
            (1.02, float(height)),
            xycoords=("axes fraction", "data"),
            color=color,
            fontsize=8,
            va="center",
            annotation_clip=False,
        )


def _beside(axes: Axes, text: str, *, x: float) -> None:
    """A remark at a vertical line, on the side that has the room."""
    left = x > math.sqrt(ANGLES_DEG[0] * ANGLES_DEG[1])
    axes.annotate(
        text,
        (x, 0.04),
        xytext=(-3 if left else 3, 0),
        textcoords="offset points",
        ha="right" if left else "left",
        color=MUTED,
        fontsize=7.5,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.0},
        annotation_clip=False,
    )


def _title(figure: Figure, text: str) -> None:
    width, height = figure.get_size_inches()
    figure.suptitle(
        text, x=0.12 / width, y=1.0 - 0.12 / height, ha="left", va="top", color=INK, fontsize=11
    )
