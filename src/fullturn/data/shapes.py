"""Where shapes come from: mesh packs, mesh files, our own generator; `stored` has point samples.

Every source gives points in the unit ball of its shape. A mesh is centered on the mean of 4,096
surface samples, the farthest of which lies at distance 1.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from fullturn.data.npz import open_npz
from fullturn.data.procedural import procedural_family, procedural_mesh
from fullturn.data.provenance import sha256_of_file, sha256_of_files
from fullturn.data.surface import sample_surface
from fullturn.errors import InputError, ReadError
from fullturn.io.load import MESH_SUFFIXES, load_mesh

_NORMALIZATION_COUNT = 4096
# fmt: off
PACK_KEYS = (
    "vertices", "faces", "vertex_offsets", "face_offsets", "name", "category", "source", "split",
)
# fmt: on


class ShapeSource(ABC):
    """Shapes by number: each has points, a name and a category."""

    stored_points: int | None = None  # all that a shape has; None: as many as are asked for

    @cached_property
    def description(self) -> dict[str, Any]:
        """What the shapes are, as JSON values: kind, file, hash, part, count; no folders."""
        return {"kind": type(self).__name__, "count": len(self)}

    @abstractmethod
    def __len__(self) -> int:
        """The number of shapes."""

    @abstractmethod
    def name(self, index: int) -> str:
        """A name, unique within the source."""

    @abstractmethod
    def category(self, index: int) -> str:
        """What kind of object it is, "" if unknown."""

    @abstractmethod
    def points(
        self, index: int, count: int, rng: np.random.Generator
    ) -> Float[np.ndarray, "count 3"]:
        """`count` points of the surface in the unit ball, float64, in random order."""

    def points_pair(
        self, index: int, count: int, rng: np.random.Generator
    ) -> tuple[Float[np.ndarray, "count 3"], Float[np.ndarray, "count 3"]]:
        """Two samples of one surface that share no point, as two scanners would give."""
        sample = self.points(index, 2 * count, rng)
        return sample[:count], sample[count:]


class MeshSource(ShapeSource):
    """Shapes that are triangle meshes: samples are drawn afresh, so two draws are independent."""

    @abstractmethod
    def raw_mesh(self, index: int) -> trimesh.Trimesh:
        """The mesh as it is stored."""

    def mesh(self, index: int) -> trimesh.Trimesh:
        """The mesh, scaled to the unit ball; the same at every call."""
        mesh = self.raw_mesh(index)
        sample = sample_surface(mesh, _NORMALIZATION_COUNT, np.random.default_rng(index))
        center = sample.mean(axis=0)
        radius = np.linalg.norm(sample - center, axis=1).max()
        return trimesh.Trimesh((mesh.vertices - center) / radius, mesh.faces, process=False)

    def points(
        self, index: int, count: int, rng: np.random.Generator
    ) -> Float[np.ndarray, "count 3"]:
        return sample_surface(self.mesh(index), count, rng)


class MeshPack(MeshSource):
    """Meshes of one `.npz` file: 16-bit vertices and faces of all meshes, one after the other.

    Keys: `vertices`, `faces`, `vertex_offsets`, `face_offsets`, `name`, `category`, `source`,
    `split`, and, if known, `licence`. Only the meshes of `split` and `sources` (None: all) are
    visible.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        split: str | None = None,
        sources: Collection[str] | None = None,
    ) -> None:
        pack = open_npz(path, PACK_KEYS)
        self._path, self._split, self._sources = Path(path), split, sources
        self._vertices, self._faces = pack["vertices"], pack["faces"]
        self._vertex_offsets, self._face_offsets = pack["vertex_offsets"], pack["face_offsets"]
        keep = np.ones(len(pack["name"]), dtype=bool)
        if split is not None:
            keep &= pack["split"] == split
        if sources is not None:
            keep &= np.isin(pack["source"], list(sources))
        if not keep.any():
            raise InputError(
                f"expected meshes of split {split or 'any'} and source "
                f"{'any' if sources is None else ' or '.join(sources)} in {path}, found none; "
                f"splits: {', '.join(sorted(set(pack['split'].tolist())))}; "
                f"sources: {', '.join(sorted(set(pack['source'].tolist())))}"
            )
        self._index = np.flatnonzero(keep)
        self._name, self._category = pack["name"], pack["category"]
        licenses = pack["licence"][keep].tolist() if "licence" in pack else []
        self._license = "; ".join(sorted(set(licenses))) or None

    @cached_property
    def description(self) -> dict[str, Any]:
        return {
            "kind": "mesh pack",
            "file": self._path.name,
            "sha256": sha256_of_file(self._path),
            "part": self._split,
            **({} if self._sources is None else {"sources": sorted(self._sources)}),
            "count": len(self),
            "license": self._license,
        }

    def __len__(self) -> int:
        return len(self._index)

    def name(self, index: int) -> str:
        return str(self._name[self._index[index]])

    def category(self, index: int) -> str:
        return str(self._category[self._index[index]])

    def raw_mesh(self, index: int) -> trimesh.Trimesh:
        i = self._index[index]
        vertices = self._vertices[self._vertex_offsets[i] : self._vertex_offsets[i + 1]]
        faces = self._faces[self._face_offsets[i] : self._face_offsets[i + 1]]
        return trimesh.Trimesh(
            vertices.astype(np.float64) / 32767, faces.astype(np.int64), process=False
        )


class MeshFolder(MeshSource):
    """All mesh files below a folder, by relative path; the first folder is the category."""

    def __init__(self, path: str | Path) -> None:
        self._root = Path(path)
        self._files = sorted(
            file
            for file in self._root.rglob("*")
            if file.suffix.lower() in MESH_SUFFIXES and not file.name.startswith(".")
        )
        if not self._files:
            raise ReadError(
                f"expected mesh files ({', '.join(MESH_SUFFIXES)}) below {path}, found "
                "none; check the folder"
            )

    @cached_property
    def description(self) -> dict[str, Any]:
        return {
            "kind": "mesh folder",
            "file": self._root.resolve().name,
            "sha256": sha256_of_files(self._files, root=self._root),
            "part": None,
            "count": len(self),
            "license": None,
        }

    def __len__(self) -> int:
        return len(self._files)

    def name(self, index: int) -> str:
        return self._files[index].relative_to(self._root).with_suffix("").as_posix()

    def category(self, index: int) -> str:
        parts = self._files[index].relative_to(self._root).parts
        return parts[0] if len(parts) > 1 else ""

    def raw_mesh(self, index: int) -> trimesh.Trimesh:
        return load_mesh(self._files[index])


class ProceduralShapes(MeshSource):
    """`count` generated objects; object i depends only on (seed, i)."""

    def __init__(self, count: int, seed: int = 0) -> None:
        if count < 1 or seed < 0:
            raise InputError(
                f"expected a count of at least 1 and a seed of at least 0, got {count} and {seed}; "
                "change them"
            )
        self._count, self._seed = count, seed

    @cached_property
    def description(self) -> dict[str, Any]:
        return {
            "kind": "procedural",
            "seed": self._seed,
            "count": self._count,
            "license": "none needed: made by formulas",
        }

    def __len__(self) -> int:
        return self._count

    def name(self, index: int) -> str:
        return f"procedural_{self._seed}_{index:05d}"

    def category(self, index: int) -> str:
        return procedural_family(np.random.default_rng([self._seed, index]))

    def raw_mesh(self, index: int) -> trimesh.Trimesh:
        return procedural_mesh(np.random.default_rng([self._seed, index]))
