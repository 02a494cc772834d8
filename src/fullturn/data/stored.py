"""Shapes that are stored point samples, and the ModelNet40 pack among them."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped

from fullturn.data.npz import open_npz
from fullturn.data.provenance import sha256_of_file
from fullturn.data.shapes import ShapeSource
from fullturn.errors import InputError

MODELNET40_LICENSE = "ModelNet's own terms: academic research"
MODELNET_KEYS = ("points", "scale", "name", "cls", "use")


class StoredPoints(ShapeSource):
    """A fixed number of points a shape, in the dataset's own normalization.

    Draws are without replacement; `points_pair` splits one draw, so its two clouds are disjoint.
    """

    def __init__(
        self,
        points: Shaped[np.ndarray, "shapes stored 3"],
        names: list[str],
        categories: list[str],
        *,
        scale: float = 1.0,
    ) -> None:
        """`points` may be integers, to be divided by `scale`."""
        self._points, self._names, self._categories = points, names, categories
        self._scale = scale
        self.stored_points = int(points.shape[1])

    def __len__(self) -> int:
        return len(self._points)

    def name(self, index: int) -> str:
        return self._names[index]

    def category(self, index: int) -> str:
        return self._categories[index]

    def points(
        self, index: int, count: int, rng: np.random.Generator
    ) -> Float[np.ndarray, "count 3"]:
        stored = self._points[index]
        if count > len(stored):
            raise InputError(
                f"expected at most {len(stored)} points of {self.name(index)}, got {count}; "
                "ask for fewer or use a mesh source"
            )
        drawn = stored[rng.permutation(len(stored))[:count]].astype(np.float64)
        return drawn / self._scale


class ModelNetSubset(StoredPoints):
    """Stored ModelNet40 samples of one `.npz` file, in random order; largest radius 1.

    Keys: `points` int16 (M, 4096, 3), `scale`, `name`, `cls`, `use`. The center is the dataset's
    own, not the mean.
    """

    def __init__(self, path: str | Path, *, use: str = "dev_eval") -> None:
        pack = open_npz(path, MODELNET_KEYS)
        keep = pack["use"] == use
        if not keep.any():
            raise InputError(
                f"expected shapes with use {use!r}, found none in {path}; "
                f"there are: {', '.join(sorted(set(pack['use'].tolist())))}"
            )
        super().__init__(
            pack["points"][keep],
            pack["name"][keep].tolist(),
            pack["cls"][keep].tolist(),
            scale=float(pack["scale"]),
        )
        self._path, self._use = Path(path), use

    @cached_property
    def description(self) -> dict[str, Any]:
        return {
            "kind": "part of ModelNet40",
            "file": self._path.name,
            "sha256": sha256_of_file(self._path),
            "part": self._use,
            "count": len(self),
            "license": MODELNET40_LICENSE,
        }
