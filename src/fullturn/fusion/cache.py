"""Finished pairs on disk, written as they come: a stopped fusion goes on where it was."""

from __future__ import annotations

import json
import os
import zlib
from typing import Any

from fullturn.errors import InputError, WriteError
from fullturn.io.atomic import make_folder, write_atomic

_HEADER = '{"format": "fullturn fuse", "version": 1}'


class EdgeCache:
    """The edges of pairs by a key that says all that they depend on.

    One file, `edges.jsonl`, one line per pair with a checksum; a line that was cut off or damaged
    is dropped, so its pair is registered again. Other inputs have other keys and find nothing.

    Raises:
        InputError: the folder's `edges.jsonl` is something else.
        WriteError: the folder cannot be made, or the file not be read.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.path = make_folder(folder) / "edges.jsonl"
        self._found: dict[str, dict[str, Any]] = {}
        self.before = 0  # pairs that were there at the start
        self.used = 0
        if not self.path.exists():
            write_atomic(self.path, _HEADER + "\n")
            return
        try:
            content = self.path.read_bytes().decode("utf-8", "replace")
        except OSError as error:
            raise WriteError(
                f"cannot use the cache {self.path}: {error.strerror}; choose another folder"
            ) from error
        header, *lines = content.splitlines() or [""]
        if header != _HEADER:
            raise InputError(
                f"{self.path}: expected a cache of fused pairs, its first line says otherwise; "
                "choose another folder"
            )
        kept = [line for line in lines if self._take(line)]
        if len(kept) < len(lines) or not content.endswith("\n"):
            write_atomic(self.path, "".join(line + "\n" for line in [header, *kept]))
        self.before = len(self._found)

    def get(self, key: str) -> dict[str, Any] | None:
        """What is known of a pair, or None."""
        found = self._found.get(key)
        self.used += found is not None
        return found

    def add(self, key: str, fields: dict[str, Any]) -> None:
        """Keep a pair, here and on disk."""
        self._found[key] = fields
        content = {"key": key, "edge": fields}
        line = json.dumps({**content, "check": zlib.crc32(json.dumps(content).encode())})
        try:
            with open(self.path, "a", encoding="utf-8") as stream:
                stream.write(line + "\n")
        except OSError as error:
            raise WriteError(
                f"cannot write the cache {self.path}: {error.strerror}; choose another folder"
            ) from error

    def _take(self, line: str) -> bool:
        try:
            content = json.loads(line)
            if content.pop("check") != zlib.crc32(json.dumps(content).encode()):
                return False
            self._found[content["key"]] = content["edge"]
        except (ValueError, KeyError, TypeError, AttributeError):
            return False
        return True
