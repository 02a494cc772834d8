"""The vertices and faces of a model, or its points, out of whatever a user has."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fullturn.geometry.extent import strays
from fullturn.io import load_cloud
from fullturn.io.load import MESH_SUFFIXES, mesh_parts, read_raw


@dataclass(frozen=True, eq=False)
class ModelSource:
    """A mesh, or a complete cloud where `faces` is None."""

    points: np.ndarray  # (n, 3) float64: on the surface; of a mesh its vertices
    faces: np.ndarray | None  # (f, 3) int64
    name: str
    notes: tuple[str, ...]

    @property
    def key(self) -> str:
        """Hash of the coordinates and faces: the same for the same model."""
        digest = hashlib.sha256(np.ascontiguousarray(self.points).tobytes())
        if self.faces is not None:
            digest.update(np.ascontiguousarray(self.faces).tobytes())
        return digest.hexdigest()


def load_model(model: Any) -> ModelSource:
    """Read a file or take an object as a mesh or a complete cloud.

    Triangles with NaN or infinite corners, and vertices without a triangle, are left out.

    Raises:
        InputError: an object of another kind, or one that determines no pose.
        ReadError: a file that cannot be read.
    """
    label = None if isinstance(model, (str, os.PathLike)) else "model"
    cloud = load_cloud(model, name=label)  # every check, and the points where it is no mesh
    found = _mesh_file(Path(model)) if label is None else _mesh_object(model)
    if found is None:
        stray = strays(cloud.points)
        left_out = int(stray.sum())
        notes = (
            (f"{cloud.name}: left out {left_out} point(s) far from the rest",) if left_out else ()
        )
        return ModelSource(cloud.points[~stray], None, cloud.name, (*cloud.notes, *notes))
    vertices, faces = found
    finite = np.isfinite(vertices).all(axis=1)[faces].all(axis=1)
    used, faces = np.unique(faces[finite], return_inverse=True)
    told = tuple(note for note in cloud.notes if "sampled" not in note)
    return ModelSource(vertices[used], faces.reshape(-1, 3), cloud.name, told)


def _mesh_file(path: Path) -> tuple[np.ndarray, np.ndarray] | None:
    if path.suffix.lower() not in MESH_SUFFIXES:
        return None
    raw = read_raw(path)
    if raw.faces is None or len(raw.faces) == 0:
        return None
    return raw.points.astype(np.float64), raw.faces


def _mesh_object(model: Any) -> tuple[np.ndarray, np.ndarray] | None:
    mesh = mesh_parts(model)
    if mesh is None:
        return None
    return np.asarray(mesh[0], dtype=np.float64), np.asarray(mesh[1], dtype=np.int64)
