"""Draw what an MVP-RG set is like: example pairs before and after alignment, and its statistics.

    python benchmarks/mvp_rg_pictures.py DIR [--out docs/images]

DIR is a set that `fullturn build mvp-rg` made; its test pairs are drawn. Prints the statistics too.
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from fullturn.data.mvp_rg import MvpRgPairs
from fullturn.evaluation.metrics import rotation_error_deg
from fullturn.geometry.motion import move
from fullturn.viz.canvas import new_figure
from fullturn.viz.curves import COLORS, save_curves
from fullturn.viz.figures import INK, MUTED, SOURCE, TARGET, draw_panel
from fullturn.viz.scene import viewing_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_EXAMPLES = 6


def draw_pairs(pairs: MvpRgPairs) -> Figure:
    """Pairs of different categories: as they are, and under their true pose."""
    first: dict[str, int] = {}
    for index in range(len(pairs)):
        first.setdefault(pairs.facts(index)["category"], index)
    figure = new_figure(figsize=(2.0 * _EXAMPLES, 4.2), layout="constrained")
    grid = figure.subplots(2, _EXAMPLES)
    for column, index in zip(grid.T, list(first.values())[:_EXAMPLES], strict=False):
        pair, facts = pairs.pair(index), pairs.facts(index)
        aligned = move(pair.T_target_source, pair.source)
        axes = viewing_axes(np.concatenate([aligned, pair.target]))
        for panel, source in zip(column, (pair.source, aligned), strict=True):
            both = np.concatenate([source, pair.target]) @ axes.T
            colors = np.repeat([to_rgb(SOURCE), to_rgb(TARGET)], len(pair.source), axis=0)
            name = f"overlap {facts['overlap']:.2f}" if source is aligned else ""
            draw_panel(panel, name, both, colors, height=float(np.ptp(both, axis=0).max()))
    return figure


def draw_statistics(pairs: MvpRgPairs) -> Figure:
    """Histograms of overlap and angle, and the pairs of each category, the largest ones."""
    facts = [pairs.facts(index) for index in range(len(pairs))]
    overlap = np.array([one["overlap"] for one in facts])
    angle_deg = np.array([rotation_error_deg(pair.T_target_source, np.eye(4)) for pair in pairs])
    categories = Counter(one["category"] for one in facts)
    levels = Counter(pairs.group(index) for index in range(len(pairs)))
    print(f"{len(pairs)} pairs of {len(categories)} categories; {dict(levels)}")
    for name, values in (("overlap", overlap), ("angle, °", angle_deg)):
        low, middle, high = np.quantile(values, (0.05, 0.5, 0.95))
        print(f"{name}: mean {values.mean():.3g}, quantiles {low:.3g}, {middle:.3g}, {high:.3g}")
    figure = new_figure(figsize=(9.2, 2.8), layout="constrained")
    left, middle_axes, right = figure.subplots(1, 3)
    left.hist(overlap, bins=28, range=(0.3, 1.0), color=COLORS[0])
    middle_axes.hist(angle_deg, bins=36, range=(0.0, 180.0), color=COLORS[0])
    counts = [count for _, count in categories.most_common()]
    right.bar(range(len(counts)), counts, width=1.0, color=COLORS[0])
    _finish(left, "Overlap")
    _finish(middle_axes, "Angle between the clouds, °")
    _finish(right, "Pairs of each category")
    return figure


def _finish(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", color=INK, fontsize=10)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=MUTED, labelsize=8)


def main() -> None:
    """Write both pictures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    told = parser.parse_args()
    pairs = MvpRgPairs(told.folder)
    save_curves(told.out / "mvp_rg_pairs.png", draw_pairs(pairs), dpi=75)
    save_curves(told.out / "mvp_rg_statistics.png", draw_statistics(pairs))


if __name__ == "__main__":
    main()
