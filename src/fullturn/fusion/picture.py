"""The graph of a fusion as a picture: scans on a circle, group by group, pairs as lines."""

from __future__ import annotations

import math
from collections.abc import Sequence

from fullturn.fusion.result import Fusion
from fullturn.viz.tables import text

_SURE = 0.5  # a pair this sure of a pose that the fusion doesn't hold is drawn, as a warning
_SIDE, _RADIUS, _NAMES = 360.0, 130.0, 24


def graph_picture(fusion: Fusion, colors: Sequence[tuple[int, int, int]]) -> str:
    """An SVG element; a scan's dot has its color, and up to 24 scans have their numbers."""
    around = [scan for group in fusion.groups for scan in group]
    place = {}
    for position, scan in enumerate(around):
        angle = 2.0 * math.pi * position / len(around) - math.pi / 2.0
        place[scan] = (math.cos(angle), math.sin(angle))

    def at(scan: int, radius: float = _RADIUS) -> tuple[float, float]:
        x, y = place[scan]
        return round(_SIDE / 2 + radius * x, 1), round(_SIDE / 2 + radius * y, 1)

    parts = [f'<svg viewBox="0 0 {_SIDE:g} {_SIDE:g}" role="img" aria-label="Graph of the pairs">']
    for edge in fusion.edges:
        (x1, y1), (x2, y2) = at(edge.target), at(edge.source)
        ends = f'x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}"'
        if edge.chosen >= 0:
            strength = edge.probability[edge.chosen]
            parts.append(
                f'<line {ends} stroke="var(--accent)" stroke-width="{1 + 2 * strength:.2f}" '
                f'stroke-opacity="{0.25 + 0.75 * strength:.2f}"/>'
            )
        elif edge.probability and edge.probability[0] >= _SURE:
            parts.append(f'<line {ends} stroke="#c0392b" stroke-dasharray="5 4"/>')
    for scan in around:
        x, y = at(scan)
        name = f"<title>{text(fusion.names[scan])}</title>"
        parts.append(f'<circle cx="{x}" cy="{y}" r="7" fill="rgb{colors[scan]}">{name}</circle>')
        if len(around) <= _NAMES:
            x, y = at(scan, _RADIUS + 20)
            parts.append(f'<text x="{x}" y="{y + 4}">{scan + 1}</text>')
    return "\n".join([*parts, "</svg>"])
