"""What every file reader returns, before checks and surface sampling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Raw:
    """Points as they stand in a file, NaN included; with faces, they are a mesh's vertices."""

    points: np.ndarray  # (n, 3), real, in the file's own precision
    faces: np.ndarray | None = None  # (f, 3) int64 indices into points
    notes: tuple[str, ...] = ()
