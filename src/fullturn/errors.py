"""Every error that fullturn raises on purpose: what was expected, what came, what to do."""

from __future__ import annotations

import operator
from numbers import Real
from typing import Any


class FullturnError(Exception):
    """Base of all named errors; the command line prints it as one line and exits with 1."""


class InputError(FullturnError, ValueError):
    """An argument cannot be used: its shape, type, values or name."""


class ReadError(FullturnError, OSError):
    """A file cannot be read: missing, unreadable, truncated, mislabeled or of an unknown kind."""


class WriteError(FullturnError, OSError):
    """An output cannot be written; nothing is left half-written."""


class DependencyError(FullturnError, ImportError):
    """An optional package is missing; the message names the extra to install."""


def is_number(value: object) -> bool:
    """Whether a caller gave a real number; True and False are none."""
    return isinstance(value, Real) and not isinstance(value, bool)


def whole_number(value: Any, name: str, *, least: int) -> int:
    """The value of an argument that counts something, as an int; NumPy's integers will do.

    Raises:
        InputError: no whole number, or less than `least`.
    """
    try:
        number = least - 1 if isinstance(value, bool) else operator.index(value)
    except TypeError:
        number = least - 1
    if number < least:
        raise InputError(f"{name}: expected a whole number of at least {least}, got {value!r:.80}")
    return number


def one_line(text: object) -> str:
    """Any text as one printable line, so that an error message is always one line.

    >>> one_line("a\\nb")
    'a b'
    """
    line = " ".join(str(text).split())
    return line.encode("utf-8", "backslashreplace").decode() or "(empty)"
