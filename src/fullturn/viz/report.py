"""One HTML file that shows a registration: an interactive view and every figure of merit."""

from __future__ import annotations

import html
from importlib import resources
from typing import TYPE_CHECKING

from fullturn.io.atomic import write_atomic
from fullturn.viz import tables
from fullturn.viz.page import render_page
from fullturn.viz.payload import make_payload
from fullturn.viz.scene import make_scene

if TYPE_CHECKING:
    from os import PathLike

    from numpy.typing import ArrayLike

    from fullturn.result import Registration

MAX_POINTS = 30_000  # per cloud; with the distances this keeps the file near 1 MB
MAX_MATCHES = 250  # more lines than this hide one another
MAX_ALTERNATIVES = 6  # with a view of their own; the table lists all


def write_report(
    path: str | PathLike[str],
    source_points: ArrayLike,
    target_points: ArrayLike,
    registration: Registration,
    *,
    source_name: str = "source",
    target_name: str = "target",
) -> None:
    """Write one self-contained HTML file that shows the registration and works offline.

    The points, `(N, 3)` and `(M, 3)`, are those that were registered, because
    `registration.matches` are indices into them.

    Raises:
        InputError: the points have another shape or are not finite.
        WriteError: the path cannot be written; what was there before is kept.
    """
    text = render_report(
        source_points,
        target_points,
        registration,
        source_name=source_name,
        target_name=target_name,
    )
    write_atomic(path, text)


def render_report(
    source_points: ArrayLike,
    target_points: ArrayLike,
    registration: Registration,
    *,
    source_name: str = "source",
    target_name: str = "target",
) -> str:
    """Return the page that `write_report` writes; the same input gives the same text."""
    scene = make_scene(
        source_points,
        target_points,
        registration,
        max_points=MAX_POINTS,
        max_alternatives=MAX_ALTERNATIVES,
        max_matches=MAX_MATCHES,
    )
    payload = make_payload(scene, registration)
    length = tables.length_format(scene.size)
    assets = resources.files("fullturn.viz") / "assets"
    names = {"source_name": tables.text(source_name), "target_name": tables.text(target_name)}
    return render_page(
        (assets / "report.html").read_text(encoding="utf-8"),
        dict(
            **names,
            method=tables.text(registration.method),
            view_buttons=view_buttons([view["name"] for view in payload["views"]]),
            far=length(scene.far),
            drawn=drawn_note(
                scene.source_total, scene.target_total, len(scene.source), len(scene.target)
            ),
            probability=tables.probability(registration.success_probability),
            probability_bar=tables.probability_bar(registration),
            probability_note=tables.probability_note(registration),
            notes=tables.notes(registration.notes),
            pose_rows=tables.pose_rows(registration, length),
            agreement_rows=tables.agreement_rows(
                registration, scene.source_total, scene.target_total
            ),
            uncertainty_rows=tables.uncertainty_rows(registration.covariance),
            matrix=tables.matrix(registration.T_target_source),
            alternatives=tables.alternatives(registration, first_view=3, views=MAX_ALTERNATIVES),
            seconds_rows=tables.seconds_rows(registration.seconds),
        ),
        title=f"{names['source_name']} → {names['target_name']}",
        scene=payload,
        script=(assets / "viewer.js").read_text(encoding="utf-8"),
    )


def view_buttons(names: list[str]) -> str:
    """Return one button per view."""
    return "\n".join(
        f'<button type="button" data-view="{i}" aria-pressed="false">{html.escape(name)}</button>'
        for i, name in enumerate(names)
    )


def drawn_note(source_total: int, target_total: int, source_drawn: int, target_drawn: int) -> str:
    """Say how many points are drawn, of how many.

    >>> drawn_note(2048, 50000, 2048, 30000)
    'Drawn: 2,048 + 30,000 of 2,048 + 50,000 points'
    """
    if (source_total, target_total) == (source_drawn, target_drawn):
        return f"{source_total:,} + {target_total:,} points"
    return (
        f"Drawn: {source_drawn:,} + {target_drawn:,} of {source_total:,} + {target_total:,} points"
    )
