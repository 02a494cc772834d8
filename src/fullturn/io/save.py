"""Write clouds by suffix."""

from __future__ import annotations

import io
import os
from typing import Any

import numpy as np

from fullturn.io.atomic import check_output, write_atomic
from fullturn.io.check import check_shape
from fullturn.io.ply import ply_bytes

CLOUD_SUFFIXES = (".ply", ".npy", ".xyz", ".txt", ".csv")


def save_cloud(path: str | os.PathLike[str], points: Any) -> None:
    """Write points (N, 3) as PLY (binary, double precision), NPY, XYZ, TXT or CSV.

    Text has 17 significant digits, so that every value reads back as it was.

    Raises:
        InputError: `points` is not a real array of shape (N, 3).
        WriteError: another suffix, or the place cannot be written.
    """
    suffix = check_output(path, CLOUD_SUFFIXES).suffix.lower()
    values = check_shape(points, "points").astype(np.float64)
    if suffix == ".ply":
        content = ply_bytes(values)
    elif suffix == ".npy":
        stream = io.BytesIO()
        np.save(stream, values, allow_pickle=False)
        content = stream.getvalue()
    else:
        stream = io.BytesIO()
        np.savetxt(stream, values, fmt="%.17g", delimiter="," if suffix == ".csv" else " ")
        content = stream.getvalue()
    write_atomic(path, content)
