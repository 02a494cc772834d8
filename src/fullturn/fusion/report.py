"""One HTML file that shows a fusion: the scans, to turn on and off, the graph and its pairs."""

from __future__ import annotations

import colorsys
import math
import os
from collections.abc import Sequence
from importlib import resources
from typing import Any

import numpy as np

from fullturn.fusion.picture import graph_picture
from fullturn.fusion.result import Fusion
from fullturn.geometry.extent import strays
from fullturn.geometry.motion import move
from fullturn.io import load_cloud
from fullturn.io.atomic import write_atomic
from fullturn.viz import tables
from fullturn.viz.page import render_page
from fullturn.viz.payload import encode_points, middle
from fullturn.viz.scene import thin, viewing_axes

_MAX_POINTS = 120_000  # of all scans together: about 1 MB
_OPEN_DEG = 20.0  # standard deviation from which on a rotation counts as not held
_GOLDEN_ANGLE = 0.381966  # of the color circle: neighbors in the list differ most


def write_fusion_report(
    path: str | os.PathLike[str], clouds: Sequence[Any], fusion: Fusion
) -> None:
    """Write one self-contained HTML file that works offline; `clouds` are those that were fused.

    Raises:
        WriteError: the path cannot be written; what was there before is kept.
    """
    write_atomic(path, render_fusion_report(clouds, fusion))


def render_fusion_report(clouds: Sequence[Any], fusion: Fusion) -> str:
    """Return the page that `write_fusion_report` writes; the same input gives the same text."""
    drawn = _drawn(clouds, fusion)
    assets = resources.files("fullturn.fusion") / "assets"
    used = sum(group >= 0 for group in fusion.group)
    count, points = len(fusion.groups), len(fusion.points)
    joined = "one group" if count == 1 else f"{count} groups that nothing firmly connects"
    colors, title = scan_colors(len(fusion.names)), f"{used} scans fused"
    return render_page(
        (assets / "fuse.html").read_text(encoding="utf-8"),
        {
            "title": title,
            "summary": tables.text(
                f"{joined}, {points:,} points in the largest, {len(fusion.edges)} pairs registered "
                f"by method {fusion.method}"
            ),
            "group_buttons": "\n".join(
                f'<button type="button" data-group="{n}">Group {n + 1}: {len(group)} scans</button>'
                for n, group in enumerate(fusion.groups)
            ),
            "drawn": f"{sum(map(len, drawn)):,} points drawn",
            "scan_rows": _scan_rows(fusion, colors),
            "notes": tables.notes(fusion.notes),
            "graph": graph_picture(fusion, colors),
            "seconds_rows": tables.seconds_rows(fusion.seconds),
            "edge_rows": _edge_rows(fusion),
        },
        title=title,
        scene=_payload(drawn, fusion, colors),
        script=(assets / "fuse.js").read_text(encoding="utf-8"),
        style=(assets / "fuse.css").read_text(encoding="utf-8"),
    )


def scan_colors(count: int) -> list[tuple[int, int, int]]:
    """Distinct colors, as red, green and blue from 0 to 255."""
    tones = [colorsys.hsv_to_rgb((0.08 + _GOLDEN_ANGLE * k) % 1.0, 0.7, 0.85) for k in range(count)]
    return [(round(255 * r), round(255 * g), round(255 * b)) for r, g, b in tones]


def rotation_sigma_deg(fusion: Fusion, number: int) -> float:
    """The standard deviation of a scan's rotation, all axes together; NaN where there is none."""
    covariance = fusion.covariance[number]
    if covariance is None or len(fusion.groups[fusion.group[number]]) < 2:
        return math.nan
    return math.degrees(math.sqrt(max(0.0, float(np.trace(covariance[:3, :3])))))


def deviation(sigma_deg: float) -> str:
    """A standard deviation as text; where nothing holds a rotation, it is no number."""
    if math.isnan(sigma_deg):
        return ""
    return f"{sigma_deg:.2f}" if sigma_deg < _OPEN_DEG else "open"


def _drawn(clouds: Sequence[Any], fusion: Fusion) -> list[np.ndarray]:
    """Some points of each scan in the frame of its group; none of a scan that was left out.

    Nor stray ones: beside them, the others would be a dot.
    """
    most = max(500, _MAX_POINTS // len(fusion.names))
    drawn = []
    for cloud, T in zip(clouds, fusion.T_world_scan, strict=True):
        points = np.zeros((0, 3)) if T is None else load_cloud(cloud).points
        drawn.append(points if T is None else move(T, thin(points[~strays(points)], most)))
    return drawn


def _payload(
    drawn: Sequence[np.ndarray], fusion: Fusion, colors: Sequence[tuple[int, int, int]]
) -> dict[str, Any]:
    """Points in units of the largest group's radius, each group around its own middle."""
    of_group = [np.concatenate([drawn[scan] for scan in group]) for group in fusion.groups]
    middles = [middle(points) for points in of_group]
    radius = max(float(np.abs(p - m).max()) for p, m in zip(of_group, middles, strict=True)) or 1.0
    return {
        "camera": viewing_axes(of_group[0] - middles[0]).ravel().tolist(),
        "dot": 0.006,
        "scans": [
            {
                **encode_points(points, middles[group] if group >= 0 else np.zeros(3), radius),
                "color": list(color),
            }
            for points, group, color in zip(drawn, fusion.group, colors, strict=True)
        ],
    }


def _scan_rows(fusion: Fusion, colors: Sequence[tuple[int, int, int]]) -> str:
    rows = []
    for number, (name, group) in enumerate(zip(fusion.names, fusion.group, strict=True)):
        state = "disabled" if group < 0 else "checked" if group == 0 else ""
        sigma = rotation_sigma_deg(fusion, number)
        alone = group >= 0 and len(fusion.groups[group]) == 1
        said = "alone" if alone else tables.probability(fusion.probability[number])
        rows.append(
            f'<tr><th><label><input type="checkbox" data-scan="{number}" data-group="{group}" '
            f'{state}> <i style="background:rgb{colors[number]}"></i>{tables.text(name)}</label>'
            f"</th><td>{group + 1 if group >= 0 else 'left out'}</td><td>{said}</td>"
            f"<td>{deviation(sigma)}</td></tr>"
        )
    return "\n".join(rows)


def _edge_rows(fusion: Fusion) -> str:
    rows = []
    for edge in fusion.edges:
        ends = ((edge.target, edge.target_scans), (edge.source, edge.source_scans))
        target, source = (
            tables.text(fusion.names[n]) + (f" and {len(held) - 1} more" if len(held) > 1 else "")
            for n, held in ends
        )
        ranked = " ".join(tables.probability(p) for p in edge.probability[:4])
        rows.append(
            f"<tr><th>{target}</th><td>{source}</td>"
            + f"<td>{ranked or tables.text(edge.error or '')}</td>"
            + f"<td>{'none' if edge.chosen < 0 else edge.chosen + 1}</td>"
            + "<td>{:.0%} {:.0%}</td></tr>".format(*edge.overlap)
        )
    return "\n".join(rows)
