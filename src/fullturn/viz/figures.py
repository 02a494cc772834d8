"""A picture of a registration for papers and pages: before, after, overlap."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np

from fullturn.geometry.motion import move, rotation_angle_deg
from fullturn.io.atomic import check_output, write_atomic
from fullturn.viz.canvas import METADATA, new_figure
from fullturn.viz.scene import make_scene, viewing_axes
from fullturn.viz.tables import probability

if TYPE_CHECKING:
    from collections.abc import Callable
    from os import PathLike

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

    from fullturn.result import Registration

MAX_POINTS = 6_000  # per cloud
SOURCE, TARGET = "#e08a00", "#2f73c8"  # told apart with any color vision
OVERLAP = ("#0a8f80", "#efc75e", "#c3c9cf")  # at the partner, halfway, far
INK, MUTED = "#1b1f24", "#626b76"


def save_figure(
    path: str | PathLike[str],
    source_points: ArrayLike,
    target_points: ArrayLike,
    registration: Registration,
    *,
    dpi: int = 160,
) -> None:
    """Write a picture with three panels: before, after, and the distance to the nearest partner.

    The suffix chooses PNG, PDF, SVG or JPEG; `dpi` is the resolution of a PNG or JPEG.

    Raises:
        DependencyError: matplotlib is missing.
        InputError: the points have another shape or are not finite.
        WriteError: another suffix, or the place cannot be written; what was there before is kept.
    """
    write_figure(path, lambda: draw_figure(source_points, target_points, registration), dpi=dpi)


def write_figure(path: str | PathLike[str], draw: Callable[[], Figure], *, dpi: int) -> None:
    """Write what `draw` returns; equal figures give equal bytes.

    The suffix chooses PNG, PDF, SVG or JPEG, and is checked before anything is drawn; `dpi` is the
    resolution of a PNG or JPEG.

    Raises:
        WriteError: another suffix, or the place cannot be written; what was there before is kept.
    """
    suffix = check_output(path, tuple(METADATA)).suffix.lower()
    figure = draw()
    from matplotlib import rc_context

    buffer = io.BytesIO()
    with rc_context({"svg.hashsalt": "fullturn"}):  # or the names in an SVG are random
        figure.savefig(buffer, format=suffix[1:], dpi=dpi, metadata=METADATA[suffix])
    write_atomic(path, buffer.getvalue())


def draw_figure(
    source_points: ArrayLike,
    target_points: ArrayLike,
    registration: Registration,
    *,
    title: str | None = None,
) -> Figure:
    """Return the figure that `save_figure` writes; no window and no global state is involved.

    `title` replaces the line that says what came out.
    """
    figure = new_figure()
    from matplotlib.colors import LinearSegmentedColormap, to_rgb
    from matplotlib.lines import Line2D

    scene = make_scene(source_points, target_points, registration, max_points=MAX_POINTS)
    moved = move(registration.T_target_source, scene.source)
    view = viewing_axes(np.concatenate([moved, scene.target]))
    source, target, aligned = (cloud @ view.T for cloud in (scene.source, scene.target, moved))
    distances = np.concatenate([scene.distances[0].source, scene.distances[0].target])
    near = np.clip(distances / scene.far if scene.far > 0 else distances, 0.0, 1.0)
    by_cloud = np.repeat([to_rgb(SOURCE), to_rgb(TARGET)], [len(source), len(target)], axis=0)
    by_distance = LinearSegmentedColormap.from_list("overlap", OVERLAP)(near)[:, :3]
    panels = {
        "Before": (np.concatenate([beside(source, target), target]), by_cloud),
        "After": (np.concatenate([aligned, target]), by_cloud),
        "Overlap": (np.concatenate([aligned, target]), by_distance),
    }
    # Columns as wide as what they show, so that all panels have one scale.
    widths = [max(float(np.ptp(points[:, 0])), 1e-9) for points, _ in panels.values()]
    height = max(float(np.ptp(points[:, 1])) for points, _ in panels.values())
    # The panels fill the width; a tall or wide shape is cut short, for a page must hold it.
    inches = min(max(11.6 * 1.04 * height / sum(widths), 2.0), 4.2)
    figure.set_size_inches(13.0, inches + 1.3)
    grid = {"width_ratios": widths, "wspace": 0.12, "left": 0.02, "right": 0.98}
    grid |= {"top": 1.0 - 0.85 / (inches + 1.3), "bottom": 0.45 / (inches + 1.3)}
    spots = figure.subplots(1, 3, gridspec_kw=grid)
    for axes, (name, (points, colors)) in zip(spots, panels.items(), strict=True):
        draw_panel(axes, name, points, colors, height=height)
    figure.suptitle(
        headline(registration) if title is None else title,
        x=0.02,
        y=1.0 - 0.12 / (inches + 1.3),
        ha="left",
        va="top",
        color=INK,
        fontsize=14,
    )
    entries = [("source", SOURCE), ("target", TARGET), ("has a partner", OVERLAP[0])]
    entries.append(("has none", OVERLAP[2]))
    handles = [
        Line2D([], [], marker="o", linestyle="", color=color, label=label)
        for label, color in entries
    ]
    figure.legend(
        handles=handles,
        loc="lower left",
        ncols=4,
        frameon=False,
        labelcolor=MUTED,
        handletextpad=0.1,
    )
    return figure


def headline(registration: Registration) -> str:
    """Say in one line what came out: rotation, probability, overlap."""
    angle = float(rotation_angle_deg(registration.T_target_source[:3, :3]))
    source, target = registration.overlap
    return (
        f"Rotation {angle:.1f}°, probability {probability(registration.success_probability)}, "
        f"overlap {100 * source:.0f} % of the source and {100 * target:.0f} % of the target"
    )


def beside(source: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move a cloud to the left of another, at the same height and depth, with a small gap.

    Columns are right, up and toward the viewer.
    """
    low, high = source.min(axis=0), source.max(axis=0)
    shift = (target.min(axis=0) + target.max(axis=0) - low - high) / 2
    shift[0] = target[:, 0].min() - high[0] - 0.08 * float(np.ptp(target, axis=0).max())
    return source + shift


def draw_panel(
    axes: Axes,
    name: str,
    points: NDArray[np.float64],
    colors: NDArray[np.float64],
    *,
    height: float,
) -> None:
    """Draw points with equal scales, the far ones first and paler."""
    order = np.argsort(points[:, 2])
    depth = points[order, 2]
    paleness = 0.5 * (depth.max() - depth) / (float(np.ptp(depth)) or 1.0)
    shaded = colors[order] + (1.0 - colors[order]) * paleness[:, None]
    # Relative to a corner, because matplotlib loses digits far from the origin.
    x, y = (points[order, :2] - points[:, :2].min(axis=0)).T
    axes.scatter(x, y, s=5.0, c=shaded, linewidths=0)
    margin = 0.52 * height or 1.0
    axes.set_ylim(float(np.ptp(y)) / 2 - margin, float(np.ptp(y)) / 2 + margin)
    axes.set_aspect("equal", adjustable="box")
    axes.set_axis_off()
    axes.set_title(name, color=MUTED, fontsize=11)
