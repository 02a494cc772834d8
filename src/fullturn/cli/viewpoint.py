"""Where a sensor stood, as an option."""

from __future__ import annotations

import math

import typer


def parse_viewpoint(text: str | None, option: str) -> tuple[float, ...] | None:
    """Three numbers with commas between them.

    Raises:
        typer.BadParameter: anything else; it names the `option`.
    """
    if text is None:
        return None
    try:
        place = tuple(float(x) for x in text.split(","))
    except ValueError:
        place = ()
    if len(place) != 3 or not all(math.isfinite(x) for x in place):
        raise typer.BadParameter(f"{option}: expected three numbers as in 0.1,-2,3; got {text!r}")
    return place
