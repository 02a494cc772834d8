"""Predictions on disk, one line each, written as they come: a killed run goes on where it was."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from fullturn.errors import WriteError
from fullturn.evaluation.predict import Prediction
from fullturn.io.atomic import write_atomic


class PredictionCache:
    """The predictions of one method, as its code is, for one seed, by the hash of the pair.

    Each line carries a checksum. A line that was cut off or damaged is dropped (`damaged` counts
    them), so its pair is predicted again.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.found: dict[str, Prediction] = {}
        self.damaged = 0
        self._stream: IO[str] | None = None
        try:
            content = self.path.read_bytes().decode("utf-8", "replace")
        except FileNotFoundError:
            return
        except OSError as error:
            raise WriteError(
                f"cannot use the cache {self.path}: {error.strerror}; choose another with --cache"
            ) from error
        kept = []
        for line in content.splitlines():
            try:
                pair, prediction = _parse(line)
            except (ValueError, KeyError, TypeError):
                self.damaged += 1
                continue
            self.found[pair] = prediction
            kept.append(line + "\n")
        if self.damaged or not content.endswith("\n"):
            write_atomic(self.path, "".join(kept))

    def add(self, pair: str, prediction: Prediction) -> None:
        """Keep a prediction, here and on disk."""
        self.found[pair] = prediction
        try:
            if self._stream is None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self._stream = open(self.path, "a", encoding="utf-8")  # noqa: SIM115
            self._stream.write(_line(pair, prediction))
            self._stream.flush()
        except OSError as error:
            raise WriteError(
                f"cannot write the cache {self.path}: {error.strerror}; choose another with --cache"
            ) from error

    def close(self) -> None:
        """Let go of the file."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None


def _line(pair: str, prediction: Prediction) -> str:
    content = {
        "pair": pair,
        "T_target_source": prediction.T_target_source.tolist(),
        "success_probability": prediction.success_probability,
        "alternatives": [T.tolist() for T in prediction.alternatives],
        "error": prediction.error,
        "cpu_seconds": prediction.cpu_seconds,
        "wall_seconds": prediction.wall_seconds,
    }
    return json.dumps({**content, "check": _checksum(content)}) + "\n"


def _parse(line: str) -> tuple[str, Prediction]:
    content = json.loads(line)
    if content.pop("check") != _checksum(content):
        raise ValueError("checksum")
    pair = content.pop("pair")
    content["T_target_source"] = np.array(content["T_target_source"])
    content["alternatives"] = tuple(np.array(T) for T in content["alternatives"])
    return pair, Prediction(**content)


def _checksum(content: Mapping[str, Any]) -> int:
    return zlib.crc32(json.dumps(content).encode())
