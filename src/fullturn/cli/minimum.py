"""The option --min-probability: what it may be, and what it does in the end."""

from __future__ import annotations

import math

import typer

from fullturn.cli.errors import BELOW_MINIMUM, tell


def check_minimum(value: float | None) -> None:
    """Refuse NaN, which passes the limits of a range."""
    if value is not None and math.isnan(value):
        raise typer.BadParameter("--min-probability: expected a number up to 1, got nan")


def exit_if_below(probability: float, minimum: float | None) -> None:
    """Say so and leave with the code for it where a probability is below the minimum."""
    if minimum is not None and probability < minimum:
        tell(f"the probability {probability:.3f} is below the --min-probability {minimum:g}")
        raise typer.Exit(BELOW_MINIMUM)
