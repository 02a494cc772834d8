"""What happened in a run, as two CSV files: a row a step, and a row a validation."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fullturn.errors import ReadError, WriteError, one_line
from fullturn.io.atomic import write_atomic
from fullturn.training.validation import Score

STEPS, SCORES = "log.csv", "validation.csv"


class RunLog:
    """Appends rows to log.csv and validation.csv; a resumed run drops the rows after its state."""

    def __init__(self, out: Path, *, losses: Sequence[str], step: int) -> None:
        self._paths = {name: out / name for name in (STEPS, SCORES)}
        self._fields = {
            STEPS: ["step", "pairs", "rate", "loss", *losses, "gradient", "seconds"],
            SCORES: list(asdict(Score(0, 0, 0.0, 0.0, 0.0, 0.0))),
        }
        self._waiting: dict[str, list[dict[str, Any]]] = {STEPS: [], SCORES: []}
        for name, path in self._paths.items():
            kept = [row for row in read_log(path) if int(row["step"]) <= step] if step else []
            write_atomic(path, self._text(name, kept, header=True))

    def add_step(self, **row: Any) -> None:
        self._waiting[STEPS].append(row)
        if len(self._waiting[STEPS]) >= 50:
            self.flush()

    def add_score(self, score: Score) -> None:
        self._waiting[SCORES].append(asdict(score))
        self.flush()

    def flush(self) -> None:
        """Bring all rows to the files.

        Raises:
            WriteError: they cannot be written.
        """
        for name, rows in self._waiting.items():
            if rows:
                try:
                    with open(self._paths[name], "a", encoding="utf-8", newline="") as stream:
                        stream.write(self._text(name, rows, header=False))
                except OSError as error:
                    raise WriteError(
                        f"cannot write {self._paths[name]}: {error.strerror}; free some space, "
                        "then go on with --resume"
                    ) from error
                rows.clear()

    def _text(self, name: str, rows: Sequence[Any], *, header: bool) -> str:
        stream = io.StringIO()
        writer = csv.DictWriter(stream, self._fields[name], lineterminator="\n")
        if header:
            writer.writeheader()
        writer.writerows(rows)
        return stream.getvalue()


def read_log(path: Path) -> list[dict[str, str]]:
    """The whole rows of a log; one that a killed run left unfinished is dropped.

    Raises:
        ReadError: it can't be read.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ReadError(
            f"expected a log at {path}: {one_line(error.strerror)}; it is part of a run folder"
        ) from error
    whole = text[: text.rfind("\n") + 1]
    return list(csv.DictReader(io.StringIO(whole)))
