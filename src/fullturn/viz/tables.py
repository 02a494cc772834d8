"""The numbers of a registration as pieces of HTML; every text from outside is escaped."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from fullturn.geometry.motion import invert, rotation_angle_deg
from fullturn.viz.scene import angle_axis

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from fullturn.result import Registration


def text(value: str) -> str:
    """Make any string safe to stand in HTML; what cannot be printed becomes U+FFFD.

    >>> text("a<b>\\x00")
    'a&lt;b&gt;\\ufffd'
    """
    return html.escape("".join(c if c.isprintable() else "\ufffd" for c in value))


def length_format(size: float) -> Callable[[float], str]:
    """Return a formatter for lengths that resolves 1/10,000 of `size`.

    >>> length_format(0.15)(0.0123456), length_format(2000.0)(1234.56)
    ('0.01235', '1,234.6')
    """
    decimals = 4 - math.floor(math.log10(size)) if 0 < size < math.inf else 5
    if not -5 <= decimals <= 9:
        return lambda value: f"{value:.5g}"
    return lambda value: f"{value:,.{max(decimals, 0)}f}"


def probability(value: float) -> str:
    """Format a probability; 0 and 1 are printed only where they are exact.

    >>> probability(0.9996), probability(0.5), probability(0.0004)
    ('> 0.999', '0.50', '< 0.001')
    """
    if not math.isfinite(value):
        return "not known"
    if 0.0 < value < 0.001:
        return "< 0.001"
    if 0.999 < value < 1.0:
        return "> 0.999"
    return f"{value:.3f}" if value < 0.1 or value > 0.9 else f"{value:.2f}"


def share(value: float) -> str:
    """Format a share as a percentage.

    >>> share(0.4567)
    '45.7 %'
    """
    return f"{100 * value:.1f} %" if math.isfinite(value) else "not known"


def row(name: str, value: str) -> str:
    """Return one line of a two-column table."""
    return f"<tr><th scope='row'>{name}</th><td>{value}</td></tr>"


def probability_bar(registration: Registration) -> str:
    """Return the widths of the answer and of all alternatives together."""
    answer = clamp(registration.success_probability)
    others = clamp(sum(other.success_probability for other in registration.alternatives))
    return bar(answer) + (bar(min(others, 1.0 - answer)) if others > 0 else "")


def clamp(value: float) -> float:
    """Return a drawable share: within [0, 1], 0 where it is not known."""
    return min(max(value, 0.0), 1.0) if math.isfinite(value) else 0.0


def bar(part: float) -> str:
    """Return a bar that fills `part` of its place."""
    return f"<i style='width:{100 * part:.2f}%'></i>"


def probability_note(registration: Registration) -> str:
    """Say what the probability is about, and what the alternatives add to it."""
    meaning = "Right means: within 5° and 5 % of the radius of the true pose."
    count = len(registration.alternatives)
    if count == 0:
        return meaning
    total = registration.success_probability + sum(
        other.success_probability for other in registration.alternatives
    )
    others = "the other pose" if count == 1 else f"the {count} other poses"
    return f"{meaning} That it is this one or {others} below: {text(probability(min(total, 1.0)))}."


def notes(lines: Sequence[str]) -> str:
    """Return the notes as a list, or nothing."""
    if not lines:
        return ""
    return f"<ul class='notes'>{''.join(f'<li>{text(line)}</li>' for line in lines)}</ul>"


def pose_rows(registration: Registration, length: Callable[[float], str]) -> str:
    """Return the motion in words: angle, axis and translation."""
    angle, axis = angle_axis(registration.T_target_source)
    t = registration.T_target_source[:3, 3]
    return "\n".join(
        [
            row("Rotation", f"{angle:.3f}°"),
            row("about the axis", vector(axis, lambda value: f"{value:.4f}")),
            row("Translation", vector(t, length)),
            row("its length", length(float(np.linalg.norm(t)))),
        ]
    )


def vector(values: NDArray[np.float64], number: Callable[[float], str]) -> str:
    """Format a vector of three.

    >>> vector(np.array([1.0, -0.5, 0.0]), "{:.1f}".format)
    '(1.0, −0.5, 0.0)'
    """
    return f"({', '.join(number(float(v) + 0.0).replace('-', '−') for v in values)})"


def agreement_rows(registration: Registration, source_total: int, target_total: int) -> str:
    """Return what the two clouds have in common in this pose."""
    symmetry = registration.symmetry
    return "\n".join(
        [
            row("Source points with a partner", share(registration.overlap[0])),
            row("Target points with a partner", share(registration.overlap[1])),
            row("Matches", f"{len(registration.matches):,}"),
            row("Points", f"{source_total:,} and {target_total:,}"),
            row("Symmetry", text(symmetry.description) if symmetry else "none found"),
            row("Method", text(registration.method)),
        ]
    )


def uncertainty_rows(covariance: NDArray[np.float64]) -> str:
    """Return standard deviations per axis: rotation in degrees, translation in the input's unit."""
    with np.errstate(invalid="ignore"):
        deviations = np.sqrt(np.diag(covariance))
    degrees, lengths = np.rad2deg(deviations[:3]), deviations[3:]
    head = "".join(f"<th scope='col'>{name}</th>" for name in ("", "x", "y", "z"))
    lines = [("Rotation (°)", degrees), ("Translation", lengths)]
    body = "".join(
        f"<tr><th scope='row'>{name}</th>{''.join(f'<td>{deviation(v)}</td>' for v in values)}</tr>"
        for name, values in lines
    )
    return f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody>"


def deviation(value: float) -> str:
    """Format a standard deviation with three digits.

    >>> deviation(0.012345), deviation(float("nan"))
    ('0.0123', 'not known')
    """
    return f"{value:.3g}" if math.isfinite(value) else "not known"


def matrix(T: NDArray[np.float64]) -> str:
    """Return the 4×4 with 12 digits, one row per line, so that it can be copied and read back."""
    cells = [[f"{value + 0.0:.12g}" for value in line] for line in T]
    widths = [max(len(line[k]) for line in cells) for k in range(4)]
    return "\n".join(
        "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True))
        for line in cells
    )


def alternatives(registration: Registration, *, first_view: int, views: int) -> str:
    """Return the table of the other poses; the first `views` get a button that shows them."""
    if not registration.alternatives:
        return "<p class='sub'>None: no other pose explains the two scans nearly as well.</p>"
    names = ("", "Probability", "Overlap (source, target)", "Differs from the answer by", "")
    head = "".join(f"<th scope='col'>{name}</th>" for name in names)
    back = invert(registration.T_target_source)
    lines = []
    for i, other in enumerate(registration.alternatives):
        angle = float(rotation_angle_deg((back @ other.T_target_source)[:3, :3]))
        button = f"<button type='button' class='small' data-view='{first_view + i}'>Show</button>"
        lines.append(
            f"<tr><th scope='row'>{i + 1}</th><td>{text(probability(other.success_probability))}"
            f"</td><td>{share(other.overlap[0])}, {share(other.overlap[1])}</td>"
            f"<td>{angle:.1f}°</td><td>{button if i < views else ''}</td></tr>"
        )
    return (
        f"<table class='grid'><thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table>"
    )


def seconds_rows(seconds: Mapping[str, float]) -> str:
    """Return one bar per stage, the total last."""
    longest = max(seconds.values(), default=0.0) or 1.0
    stages = sorted(seconds.items(), key=lambda item: item[0] == "total")
    return "\n".join(
        f"<tr><th scope='row'>{text(name)}</th><td>{bar(clamp(value / longest))}</td>"
        f"<td>{value:.3f}</td></tr>"
        for name, value in stages
    )
