"""Finished pairs on disk, written as they come: a stopped fusion goes on where it was."""

from __future__ import annotations

import os
from typing import Any

from fullturn.io.atomic import make_folder
from fullturn.io.lines import CheckedLines

_HEADER = '{"format": "fullturn fuse", "version": 1}'


class EdgeCache:
    """The edges of pairs by a key that says all that they depend on.

    One file, `edges.jsonl`, one line per pair; a line that was damaged is dropped, so its pair is
    registered again. Other inputs have other keys and find nothing.

    Raises:
        InputError: the folder's `edges.jsonl` is something else.
        WriteError: the folder cannot be made, or the file not be read.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self._found: dict[str, dict[str, Any]] = {}
        self.used = 0
        self._lines = CheckedLines(
            make_folder(folder) / "edges.jsonl",
            self._take,
            otherwise="choose another folder",
            header=_HEADER,
        )
        self.before = len(self._found)  # pairs that were there at the start

    def get(self, key: str) -> dict[str, Any] | None:
        """What is known of a pair, or None."""
        found = self._found.get(key)
        self.used += found is not None
        return found

    def add(self, key: str, fields: dict[str, Any]) -> None:
        """Keep a pair, here and on disk."""
        self._found[key] = fields
        self._lines.add({"key": key, "edge": fields})

    def _take(self, content: dict[str, Any]) -> None:
        self._found[content["key"]] = content["edge"]
