"""The table of pairs: read whole, checked row by row before any work starts."""

from __future__ import annotations

import csv
import hashlib
import io
import os
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from fullturn.errors import InputError, ReadError, one_line
from fullturn.io.text import encoding_of, three_numbers
from fullturn.methods.check import check_max_rotation

if TYPE_CHECKING:
    from fullturn.methods.base import Method

Viewpoint = tuple[float, float, float]

_NEEDED = ("source", "target")
_COLUMNS = ("id", *_NEEDED, "source_viewpoint", "target_viewpoint", "max_rotation_deg")


@dataclass(frozen=True)
class PairRow:
    """One row: two files, and what is known of how they were scanned."""

    id: str
    source: str  # as the table says it
    target: str
    source_viewpoint: Viewpoint | None = None
    target_viewpoint: Viewpoint | None = None
    max_rotation_deg: float | None = None


@dataclass(frozen=True)
class PairTable:
    """A checked table. Its bytes stay in memory, so that it can't change while a run reads it."""

    path: Path
    content: bytes
    count: int
    digest: str  # of what the rows say, not of how it is written down
    unused: tuple[str, ...]  # columns that say nothing to us

    @property
    def folder(self) -> str:
        """Where relative paths start."""
        return str(self.path.resolve().parent)

    def parts(self, size: int) -> Iterator[tuple[int, list[PairRow]]]:
        """The rows in order, `size` at a time, numbered from 0; made as they are asked for."""
        rows = _rows(self.path, self.content, None)
        number = 0
        while part := list(islice(rows, size)):
            yield number, part
            number += 1


def read_pairs(path: str | os.PathLike[str], *, method: type[Method]) -> PairTable:
    """Read and check a CSV table with the columns `source`, `target` and, if wanted, the others.

    Raises:
        ReadError: no such file, or no CSV.
        InputError: no path; a column that is missing, a cell that can't be used, an id twice, no
            pair. The message names line and column.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise InputError(
            f"pairs: expected the path of a CSV table, got a {type(path).__name__}; write the "
            "pairs to a file, or use register_many"
        )
    place = Path(path)
    try:
        content = place.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or one_line(error)
        raise ReadError(
            f"{one_line(path)}: expected a table of pairs, cannot read it ({reason}); "
            "name a .csv file"
        ) from error
    digest, count = hashlib.sha256(), 0
    for row in _rows(place, content, method):
        digest.update(repr(row).encode() + b"\n")
        count += 1
    if not count:
        raise InputError(f"{one_line(place)}: expected at least one pair, got none; add rows to it")
    unused = tuple(name for name in next(_cells(place, content))[1] if name not in _COLUMNS)
    return PairTable(place, content, count, digest.hexdigest(), unused)


def _rows(path: Path, content: bytes, method: type[Method] | None) -> Iterator[PairRow]:
    """The rows; with a method, checked for ids that come twice and limits that it can't take."""
    cells = _cells(path, content)
    _, header = next(cells)
    _check_header(path, header)
    seen: dict[str, int] = {}
    for number, (line, values) in enumerate(cells):
        if len(values) != len(header):
            raise InputError(
                f"{one_line(path)}, line {line}: expected {len(header)} cells as in the first "
                f"line, got {len(values)}; write paths with commas in quotes"
            )
        cell = dict(zip(header, values, strict=True))
        place = f"{one_line(path)}, line {line}"
        for name in ("id", *_NEEDED):
            if not cell.get(name, "-"):
                raise InputError(f"{place}, column {name}: expected a value, got none; fill it in")
        row = PairRow(
            cell.get("id", str(number)),
            cell["source"],
            cell["target"],
            _viewpoint(cell.get("source_viewpoint", ""), f"{place}, column source_viewpoint"),
            _viewpoint(cell.get("target_viewpoint", ""), f"{place}, column target_viewpoint"),
            _number(cell.get("max_rotation_deg", ""), f"{place}, column max_rotation_deg"),
        )
        if method is not None:
            first = seen.setdefault(row.id, line)
            if first != line:
                raise InputError(
                    f"{place}, column id: expected an id of its own for each pair, got "
                    f"{one_line(row.id)[:80]}, which is that of line {first}; change one of them"
                )
            try:
                check_max_rotation(row.max_rotation_deg, method)
            except InputError as error:
                raise InputError(f"{place}, column {error}") from error
        yield row


def _cells(path: Path, content: bytes) -> Iterator[tuple[int, list[str]]]:
    """The line number and the stripped cells of each record, the header first."""
    # A byte order mark is what spreadsheets begin a file with.
    stream = io.TextIOWrapper(io.BytesIO(content), encoding=encoding_of(content), newline="")
    reader = csv.reader(stream, strict=True, skipinitialspace=True)
    empty = True
    try:
        for record in reader:
            if record:
                empty = False
                yield reader.line_num, [cell.strip() for cell in record]
    except (UnicodeDecodeError, csv.Error) as error:
        raise ReadError(
            f"{one_line(path)}, line {reader.line_num + 1}: expected comma-separated values in "
            f"UTF-8, cannot read them ({one_line(error)}); save the table as CSV in UTF-8"
        ) from error
    if empty:
        raise ReadError(
            f"{one_line(path)}: expected a first line with the columns source and target, "
            "the file is empty; save the table as CSV"
        )


def _check_header(path: Path, header: list[str]) -> None:
    if missing := [name for name in _NEEDED if name not in header]:
        other = len(header) == 1 and any(mark in header[0] for mark in ";\t|")
        what = "separate the columns by commas" if other else f"name a column {missing[0]}"
        raise InputError(
            f"{one_line(path)}, line 1: expected the columns source and target, got "
            f"{one_line(', '.join(header))[:200]}; {what}"
        )
    if double := sorted({name for name in header if name in _COLUMNS and header.count(name) > 1}):
        raise InputError(
            f"{one_line(path)}, line 1: expected each column once, got {double[0]} twice; drop one"
        )


def _viewpoint(text: str, place: str) -> Viewpoint | None:
    if not text:
        return None
    viewpoint = three_numbers(text)
    if viewpoint is None:
        raise InputError(
            f"{place}: expected three numbers as in 0.1 -2 3, got {one_line(text)[:80]}; "
            "leave it empty where the place isn't known"
        )
    return viewpoint


def _number(text: str, place: str) -> float | None:
    if not text:
        return None
    try:
        return float(text)
    except ValueError as error:
        raise InputError(
            f"{place}: expected an angle above 0 and up to 180, got {one_line(text)[:80]}; "
            "leave it empty where none is known"
        ) from error
