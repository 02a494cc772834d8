"""Where a sensor stood, as an option."""

from __future__ import annotations

import typer


def parse_viewpoint(text: str | None, option: str) -> tuple[float, ...] | None:
    """Three numbers with commas or spaces between them.

    Raises:
        typer.BadParameter: anything else; it names the `option`.
    """
    if text is None:
        return None

    from fullturn.io.text import three_numbers

    place = three_numbers(text)
    if place is None:
        raise typer.BadParameter(f"{option}: expected three numbers as in 0.1,-2,3; got {text!r}")
    return place
