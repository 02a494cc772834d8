"""Show a registration: a short table for people, one JSON object for programs."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import typer
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from fullturn.errors import DependencyError
from fullturn.evaluation.layout import Table
from fullturn.geometry.motion import invert, rotation_angle_deg
from fullturn.result import Registration
from fullturn.viz.tables import probability


def print_table(result: Registration, *, source_name: str, target_name: str) -> None:
    """Print what matters of a registration as a compact table."""
    T = result.T_target_source
    table, row = titled_rows()
    row("source → target", f"{source_name} → {target_name}")
    row("rotation", f"{rotation_angle_deg(T[:3, :3]):.2f}°")
    row("translation", "  ".join(f"{x:.6g}" for x in T[:3, 3]))
    row("probability", f"{probability(result.success_probability)} that this pose is the true one")
    row("overlap", "{:.0%} of the source, {:.0%} of the target".format(*result.overlap))
    for number, other in enumerate(result.alternatives, start=1):
        angle_deg = rotation_angle_deg((invert(T) @ other.T_target_source)[:3, :3])
        shares = "{:.0%} and {:.0%}".format(*other.overlap)
        row(
            f"alternative {number}",
            f"probability {probability(other.success_probability)}, {angle_deg:.1f}° away, "
            f"overlap {shares}",
        )
    if result.symmetry is not None:
        row("symmetry", result.symmetry.description)
    for note in result.notes:
        row("note", note)
    row("seconds", f"{result.seconds['total']:.2f} ({result.method})")
    Console().print(table)


def titled_rows() -> tuple[RichTable, Callable[[str, str], None]]:
    """A table of titles and texts, and what adds a row to it."""
    table = RichTable(box=None, show_header=False, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")

    def row(title: str, text: str) -> None:
        table.add_row(title, Text(text))  # Text: a name may hold brackets that are no markup

    return table, row


def draw(path: Path, save: Callable[[Path], None]) -> None:
    """Save a picture and name it, or say why there is none: nothing else depends on it."""
    try:
        save(path)
    except DependencyError as error:
        typer.echo(f"No picture was drawn: {error}")
    else:
        typer.echo(f"The picture: {path}")


def print_json(result: Registration, *, source_name: str, target_name: str) -> None:
    """Print a registration as one JSON object on one line."""
    symmetry = result.symmetry
    content = {
        "T_target_source": result.T_target_source.tolist(),
        "success_probability": result.success_probability,
        "overlap": list(result.overlap),
        "method": result.method,
        "seconds": result.seconds,
        "rotation_deg": float(rotation_angle_deg(result.T_target_source[:3, :3])),
        "alternatives": [
            {
                "T_target_source": other.T_target_source.tolist(),
                "success_probability": other.success_probability,
                "overlap": list(other.overlap),
            }
            for other in result.alternatives
        ],
        "symmetry": None
        if symmetry is None
        else {
            "axis": symmetry.axis.tolist(),
            "order": symmetry.order,
            "description": symmetry.description,
        },
        "covariance": result.covariance.tolist(),
        "matches": len(result.matches),
        "notes": list(result.notes),
        "source": source_name,
        "target": target_name,
    }
    print(json.dumps(content))


def print_results(main: Table) -> None:
    """Print a table of results, each set's name on a line of its own so that it fits a terminal."""
    lines = [[levels[-1] for levels in main.header][1:], *(row[1:] for row in main.rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]

    def line(cells: Sequence[str]) -> str:
        numbers = (cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True))
        return "  ".join(["", cells[0].ljust(widths[0]), *numbers])

    print(line(lines[0]))
    for (name, *_), cells in zip(main.rows, lines[1:], strict=True):
        if name:
            print(name)
        print(line(cells))
    for note in main.notes:
        print(note)
