"""Read points from text: XYZ, TXT, CSV and their relatives."""

from __future__ import annotations

import io

import numpy as np

from fullturn.errors import ReadError, one_line
from fullturn.io.raw import Raw


def read_text(data: bytes, name: str) -> Raw:
    """Points from lines of numbers: the columns named x, y and z, or else the first three.

    Spaces, tabs, commas or semicolons separate; `#` starts a comment. The first line may be a
    header, or the number of points that follow; other columns are ignored.

    Raises:
        ReadError: binary data, a line without three numbers, fewer lines than announced.
    """
    if b"\0" in data[:4096]:
        raise ReadError(f"{name}: expected text, found binary data; check the file or its suffix")
    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ReadError(
            f"{name}: expected UTF-8 text, found other bytes; check the file or its suffix"
        ) from error
    first = next((i for i, line in enumerate(lines) if _content(line)), None)
    if first is None:
        return Raw(np.zeros((0, 3)))
    columns, announced = [0, 1, 2], None
    head = _content(lines[first])
    separator = _separator(head)
    words = [w.strip().strip('"') for w in head.split(separator) if w.strip()]
    if len(words) == 1 and words[0].isdigit():
        announced = int(words[0])
        first += 1
    elif not _is_number(words[0]):
        columns = _named(words)
        first += 1
    rest = next((_content(line) for line in lines[first:] if _content(line)), "")
    if not rest:
        return Raw(np.zeros((0, 3)))
    try:
        text = io.StringIO("\n".join(lines[first:]))
        points = np.loadtxt(
            text, usecols=columns, ndmin=2, comments="#", delimiter=_separator(rest)
        )
    except (ValueError, IndexError, OverflowError) as error:
        raise ReadError(
            f"{name}: expected three numbers per line, separated by spaces, tabs, commas or "
            f"semicolons: {one_line(error)[:200]}; correct that line"
        ) from error
    if announced is not None and len(points) != announced:
        raise ReadError(
            f"{name}: its first line announces {announced} points, {len(points)} came; "
            "the file is truncated"
        )
    return Raw(points)


def _content(line: str) -> str:
    """The line without comment and blanks; `//` headers (CloudCompare) lose their mark."""
    return line.split("#", 1)[0].strip().removeprefix("//").strip()


def _separator(line: str) -> str | None:
    return next((mark for mark in ";," if mark in line), None)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _named(words: list[str]) -> list[int]:
    names = [word.lower() for word in words]
    if all(axis in names for axis in "xyz"):
        return [names.index(axis) for axis in "xyz"]
    return [0, 1, 2]
