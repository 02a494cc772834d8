"""Results that come one by one: a JSON line each, so that a stopped run goes on where it was."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

Row = dict[str, Any]


def add_data(parser: argparse.ArgumentParser, what: str) -> None:
    """The option --data: a folder, by default that in FULLTURN_DATA."""
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(os.environ["FULLTURN_DATA"]) if "FULLTURN_DATA" in os.environ else None,
        help=f"the folder of {what}; else FULLTURN_DATA",
    )


def collect_rows(
    path: Path,
    make: Callable[[list[Row]], Iterable[Row]],
    *,
    tell: Callable[[Row], None] = lambda row: None,
) -> list[Row]:
    """The rows of a file and those that `make` adds, given what is there; written as they come."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = path.read_text() if path.exists() else ""
    # What a stopped run left unfinished is done again.
    whole = text[: text.rfind("\n") + 1]
    path.write_text(whole)
    rows = [json.loads(line) for line in whole.splitlines()]
    with path.open("a") as file:
        for row in make(list(rows)):
            rows.append(row)
            file.write(json.dumps(row) + "\n")
            file.flush()
            tell(row)
    return rows
