"""Write and read rigid transforms as text or JSON, exactly."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from fullturn.errors import InputError, ReadError, one_line
from fullturn.io.atomic import check_output, write_atomic

TRANSFORM_SUFFIXES = (".txt", ".json")
_KEYS = ("T_target_source", "T_scene_model")  # of what `register` and `locate` write


def write_transform(
    path: str | os.PathLike[str], T_target_source: Any, *, name: str = "T_target_source"
) -> None:
    """Write a 4×4 transform as four lines of text (.txt) or as a JSON object (.json).

    `name` is the key in JSON.

    Both hold 17 significant digits, enough to read every float64 back exactly.

    Raises:
        InputError: not a finite 4×4 matrix.
        WriteError: another suffix, or the place cannot be written.
    """
    matrix = _checked(T_target_source)
    if check_output(path, TRANSFORM_SUFFIXES).suffix.lower() == ".txt":
        content = "".join(" ".join(f"{x:.17g}" for x in row) + "\n" for row in matrix)
    else:
        content = json.dumps({name: matrix.tolist()}, indent=2) + "\n"
    write_atomic(path, content)


def read_transform(path: str | os.PathLike[str]) -> np.ndarray:
    """Read a 4×4 transform from text, or from JSON with a `T_target_source` or a `T_scene_model`.

    Raises:
        ReadError: missing or unreadable, or not a finite 4×4 matrix.
    """
    name = one_line(path)
    try:
        text = Path(path).read_text(encoding="utf-8")
        if Path(path).suffix.lower() == ".json":
            content = json.loads(text)
            return _checked(content[next(key for key in _KEYS if key in content)])
        return _checked([[float(x) for x in row.split()] for row in text.strip().splitlines()])
    except OSError as error:
        raise ReadError(f"{name}: cannot be read ({error.strerror}); check the path") from error
    except (ValueError, StopIteration, TypeError) as error:
        raise ReadError(
            f"{name}: expected a 4×4 matrix as four lines of text, or JSON with "
            f"{' or '.join(_KEYS)}; found a problem with {one_line(error)[:120]}"
        ) from error


def _checked(values: Any) -> np.ndarray:
    try:
        matrix = np.array(values, dtype=np.float64)
    except (ValueError, TypeError) as error:
        raise InputError(f"expected a 4×4 matrix, got {one_line(error)[:120]}") from error
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise InputError(f"expected a finite 4×4 matrix, got shape {matrix.shape}")
    return matrix
