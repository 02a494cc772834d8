"""The picture of the feature study: similarity by angle, change by noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import compress
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fullturn.errors import InputError
from fullturn.viz.canvas import new_figure
from fullturn.viz.figures import INK, MUTED, write_figure

if TYPE_CHECKING:
    from os import PathLike

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

    Panels = Mapping[str, Mapping[str, ArrayLike]]

# Told apart with any color vision (Okabe and Ito); the dashes tell the same in gray.
COLORS = {
    "XYZ": "#0072b2",
    "ΔXYZ": "#56b4e9",
    "RRI": "#d55e00",
    "PPF": "#009e73",
    "FPFH": "#a34d84",
}
SOLID, DASHED, DOTTED = "-", (0, (5, 2)), (0, (1, 1.6))


class Line(NamedTuple):
    """One curve of a panel: where its numbers are, and how it is drawn."""

    panel: str
    feature: str
    label: str
    style: str | tuple[int, tuple[float, ...]]

    @property
    def color(self) -> str:
        """That of the feature that its name begins with."""
        return COLORS[self.feature.replace("+", " ").split()[0]]


POSE = (
    *(Line("rotation", name, name, SOLID) for name in COLORS),
    *(
        Line("rotation", f"{name}+XYZ+ΔXYZ", f"{name} + XYZ + ΔXYZ", DASHED)
        for name in ("RRI", "PPF", "FPFH")
    ),
    Line("se3", "RRI (origin)", "RRI-SE(3), center at origin", DOTTED),
    Line("se3", "PPF (origin)", "PPF-SE(3), normals to origin", DOTTED),
    Line("se3", "FPFH (origin)", "FPFH-SE(3), normals to origin", DOTTED),
    Line("se3", "RRI (centroid)", "RRI-SE(3), own centroid", DOTTED),
    Line("se3", "PPF (centroid)", "PPF-SE(3), own centroid", DOTTED),
    Line("se3", "FPFH (centroid)", "FPFH-SE(3), own centroid", DOTTED),
)
NOISE = (
    ("XYZ", "XYZ", SOLID),
    ("ΔXYZ", "ΔXYZ", SOLID),
    ("RRI lengths", "RRI |p|, |q|", SOLID),
    ("RRI angles", "RRI angles", DASHED),
    ("PPF lengths", "PPF |d|", SOLID),
    ("PPF angles", "PPF angles", DASHED),
    ("FPFH", "FPFH", DASHED),
)


def save_robustness(path: str | PathLike[str], panels: Panels, *, dpi: int = 130) -> None:
    """Write the picture of `draw_robustness`; the suffix chooses PNG, PDF, SVG or JPEG.

    Raises:
        DependencyError: matplotlib is missing.
        InputError: a curve that is drawn is missing.
        WriteError: another suffix, or the place cannot be written; what was there before is kept.
    """
    write_figure(path, lambda: draw_robustness(panels), dpi=dpi)


def draw_robustness(panels: Panels) -> Figure:
    """Return the picture: (a) similarity by angle, (b) change by noise, (c) the same without units.

    `panels[panel][feature]` has the rows x, value, low, high, one column a point of the curve.
    """
    figure = new_figure(figsize=(13.0, 7.6))
    grid = figure.add_gridspec(
        2, 2, width_ratios=(1.2, 1), left=0.055, right=0.905, top=0.93, bottom=0.075
    )
    grid.update(wspace=0.8, hspace=0.36)
    pose = figure.add_subplot(grid[:, 0])
    _draw_pose(pose, panels)
    raw, relative = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    for axes, panel in ((raw, "noise"), (relative, "noise, relative")):
        lines = [Line(panel, *rest) for rest in NOISE]
        _draw_lines(axes, panels, lines, log=True)
        axes.set_xlabel("σ of the noise (radii)")
    relative.axhline(1.0, color=MUTED, linewidth=0.8, zorder=0)
    _name(raw, "b", "Change by noise, in each feature's own units")
    raw.set_ylabel("mean |change| (radii, rad, percent)")
    _name(relative, "c", "The same, relative to how points differ")
    relative.set_ylabel("1: two random points")
    return figure


def spread_labels(heights: Sequence[float], gap: float) -> np.ndarray:
    """Places nearest to the heights (least squares) that keep order and are `gap` apart.

    >>> spread_labels([0.0, 0.1, 5.0], 1.0).tolist()
    [-0.45, 0.55, 5.0]
    """
    order = np.argsort(heights, kind="stable")
    # Less a gap for each label below, order is all that is asked: merge blocks that violate it.
    steps = gap * np.arange(len(order))
    blocks: list[tuple[float, int]] = []
    for height in np.asarray(heights, dtype=float)[order] - steps:
        mean, size = float(height), 1
        while blocks and blocks[-1][0] > mean:
            below, count = blocks.pop()
            mean, size = (below * count + mean * size) / (count + size), count + size
        blocks.append((mean, size))
    places = np.empty(len(order))
    places[order] = np.repeat([b[0] for b in blocks], [b[1] for b in blocks]) + steps
    return places


def _draw_pose(axes: Axes, panels: Panels) -> None:
    axes.set_ylim(-0.34, 1.24)
    axes.set_yticks(np.arange(-0.2, 1.01, 0.2))
    axes.set_xticks(range(0, 181, 30), [f"{x}°" for x in range(0, 181, 30)])
    _draw_lines(axes, panels, POSE, log=False)
    for name in ("RRI", "PPF", "FPFH"):
        level = float(_curve(panels, "unrelated", name)[1, 0])
        axes.plot([0], [level], marker=">", color=COLORS[name], markersize=8, clip_on=False)
    axes.text(
        0.03,
        0.03,
        "▸  RRI, PPF, FPFH of two random points",
        transform=axes.transAxes,
        color=MUTED,
        fontsize=9,
    )
    axes.set_xlabel("rotation about z")
    axes.set_ylabel("mean cosine similarity")
    _name(axes, "a", "Similarity after a motion")


def _draw_lines(axes: Axes, panels: Panels, lines: Sequence[Line], *, log: bool) -> None:
    """Draw the curves that have values, and name each one where it ends."""
    curves = [_curve(panels, line.panel, line.feature) for line in lines]
    axes.set_xlim(0, max(float(curve[0].max()) for curve in curves))
    if log:
        # Without noise nothing changes, and zero has no place on this axis.
        curves = [np.where(curve[1] > 0, curve, np.nan) for curve in curves]
        axes.set_yscale("log")
    # A plane's points are all alike to PPF: nothing to compare with, no curve.
    known = [bool(np.isfinite(curve[1, -1])) for curve in curves]
    lines, curves = list(compress(lines, known)), list(compress(curves, known))
    for line, (x, value, *_) in zip(lines, curves, strict=True):
        width = 2.6 if line.style == DOTTED else 1.8
        axes.plot(x, value, color=line.color, linestyle=line.style, linewidth=width)
    axes.grid(axis="y", color="#e4e7ea", linewidth=0.8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=MUTED)

    # What was drawn sets the limits only when they are asked for, and the places hang on them.
    axes.set_ylim(axes.get_ylim())
    # In shares of the axis, so that one gap serves every scale.
    to_share = axes.transScale + axes.transLimits
    ends = [to_share.transform((curve[0, -1], curve[1, -1]))[1] for curve in curves]
    height = axes.get_position().height * axes.figure.get_figheight()  # type: ignore[union-attr]
    places = spread_labels(ends, 0.19 / height)
    for line, end, place in zip(lines, ends, places, strict=True):
        axes.annotate(
            line.label,
            xy=(1.0, end),
            xytext=(1.06, place),
            xycoords="axes fraction",
            textcoords="axes fraction",
            va="center",
            color=line.color,
            fontsize=9.5,
            arrowprops={
                "arrowstyle": "-",
                "color": line.color,
                "linewidth": 0.7,
                "shrinkA": 0,
                "shrinkB": 0,
                "relpos": (0, 0.5),
            },
        )


def _name(axes: Axes, letter: str, title: str) -> None:
    axes.set_title(f"({letter})  {title}", loc="left", color=INK, fontsize=12)


def _curve(panels: Panels, panel: str, feature: str) -> np.ndarray:
    try:
        curve = np.asarray(panels[panel][feature], dtype=float)
    except KeyError:
        raise InputError(
            f"expected a curve of {feature!r} in the panel {panel!r}, found none; "
            "pass all panels of the study"
        ) from None
    if curve.ndim != 2 or len(curve) != 4:
        raise InputError(
            f"expected the rows x, value, low, high of {feature!r}, got shape {curve.shape}"
        )
    return curve
