"""JSON objects on disk, one a line with a checksum, written as they come."""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fullturn.errors import InputError, WriteError
from fullturn.io.atomic import write_atomic


class CheckedLines:
    """The lines of a cache; one that was cut off or damaged is dropped, and `damaged` counts them.

    What is there at the start is handed to `take`, line by line; one that `take` can't use, as a
    ValueError, KeyError or TypeError says, is damaged, too. With a `header`, that is the first
    line. `otherwise` says in errors what to do.

    Raises:
        InputError: the file begins with another line than the header.
        WriteError: the file cannot be read, or cleaned of damaged lines.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        take: Callable[[dict[str, Any]], None],
        *,
        otherwise: str,
        header: str | None = None,
    ) -> None:
        self.path = Path(path)
        self.damaged = 0
        self._otherwise, self._header = otherwise, header
        first = [] if header is None else [header]
        try:
            content = self.path.read_bytes().decode("utf-8", "replace")
        except FileNotFoundError:
            if first:
                write_atomic(self.path, f"{header}\n")
            return
        except OSError as error:
            raise self._error("use", error) from error
        lines = content.splitlines()
        if lines[: len(first)] != first:
            raise InputError(
                f"{self.path}: expected a file that begins with {header}, its first line says "
                f"otherwise; {otherwise}"
            )
        kept = first
        for line in lines[len(first) :]:
            try:
                take(_parse(line))
            except (ValueError, KeyError, TypeError):
                self.damaged += 1
            else:
                kept.append(line)
        if self.damaged or not content.endswith("\n"):
            write_atomic(self.path, "".join(f"{line}\n" for line in kept))

    def add(self, content: Mapping[str, Any]) -> None:
        """Write one more line; the header first where somebody has taken the file away.

        Raises:
            WriteError: the file, or its folder, cannot be written.
        """
        line = json.dumps({**content, "check": _checksum(content)})
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with open(self.path, "a", encoding="utf-8") as stream:
                if self._header is not None and stream.tell() == 0:
                    stream.write(f"{self._header}\n")
                stream.write(f"{line}\n")
        except OSError as error:
            raise self._error("write", error) from error

    def _error(self, verb: str, error: OSError) -> WriteError:
        return WriteError(
            f"cannot {verb} the cache {self.path}: {error.strerror}; {self._otherwise}"
        )


def _parse(line: str) -> dict[str, Any]:
    content = json.loads(line)
    if not isinstance(content, dict) or content.pop("check") != _checksum(content):
        raise ValueError("damaged")
    return content


def _checksum(content: Mapping[str, Any]) -> int:
    return zlib.crc32(json.dumps(content).encode())
