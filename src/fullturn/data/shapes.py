"""Where shapes come from: mesh packs, ModelNet40 samples, mesh files, our own generator.

Every source gives points in the unit ball of its shape. A mesh is centered on the mean of 4,096
surface samples, the farthest of which lies at distance 1; stored ModelNet40 points keep the
dataset's own normalization (largest radius 1, center not the mean).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float

from fullturn.data.procedural import procedural_mesh
from fullturn.data.surface import sample_surface
from fullturn.errors import InputError, ReadError

_MESH_SUFFIXES = {".glb", ".gltf", ".obj", ".off", ".ply", ".stl"}
_NORMALIZATION_COUNT = 4096


class ShapeSource(ABC):
    """Shapes by number: each has points, a name and a category."""

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

    @abstractmethod
    def points_pair(
        self, index: int, count: int, rng: np.random.Generator
    ) -> tuple[Float[np.ndarray, "count 3"], Float[np.ndarray, "count 3"]]:
        """Two samples of one surface that share no point, as two scanners would give."""


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

    def points_pair(
        self, index: int, count: int, rng: np.random.Generator
    ) -> tuple[Float[np.ndarray, "count 3"], Float[np.ndarray, "count 3"]]:
        sample = sample_surface(self.mesh(index), 2 * count, rng)
        return sample[:count], sample[count:]


class MeshPack(MeshSource):
    """Meshes of one `.npz` file: 16-bit vertices and faces of all meshes, one after the other.

    Keys: `vertices`, `faces`, `vertex_offsets`, `face_offsets`, `name`, `category`, `source`,
    `split`. Only the meshes of `split` and `sources` (None: all) are visible.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        split: str | None = None,
        sources: Collection[str] | None = None,
    ) -> None:
        pack = _open_npz(path, ("vertices", "faces", "vertex_offsets", "face_offsets", "name"))
        self._vertices, self._faces = pack["vertices"], pack["faces"]
        self._vertex_offsets, self._face_offsets = pack["vertex_offsets"], pack["face_offsets"]
        keep = np.ones(len(pack["name"]), dtype=bool)
        if split is not None:
            keep &= pack["split"] == split
        if sources is not None:
            keep &= np.isin(pack["source"], list(sources))
        if not keep.any():
            raise InputError(
                f"expected meshes with split {split!r}, sources {sources} in {path}, found none; "
                f"splits: {sorted(set(pack['split']))}, sources: {sorted(set(pack['source']))}"
            )
        self._index = np.flatnonzero(keep)
        self._name, self._category = pack["name"], pack["category"]

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
            file for file in self._root.rglob("*") if file.suffix.lower() in _MESH_SUFFIXES
        )
        if not self._files:
            raise ReadError(
                f"expected mesh files ({', '.join(sorted(_MESH_SUFFIXES))}) below {path}, found "
                "none; check the folder"
            )

    def __len__(self) -> int:
        return len(self._files)

    def name(self, index: int) -> str:
        return self._files[index].relative_to(self._root).with_suffix("").as_posix()

    def category(self, index: int) -> str:
        parts = self._files[index].relative_to(self._root).parts
        return parts[0] if len(parts) > 1 else ""

    def raw_mesh(self, index: int) -> trimesh.Trimesh:
        mesh = trimesh.load(self._files[index], force="mesh", process=False)
        if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
            raise ReadError(
                f"expected a triangle mesh in {self._files[index]}, found no faces; remove the file"
            )
        return mesh


class ProceduralShapes(MeshSource):
    """`count` generated objects; object i depends only on (seed, i)."""

    def __init__(self, count: int, seed: int = 0) -> None:
        self._count, self._seed = count, seed

    def __len__(self) -> int:
        return self._count

    def name(self, index: int) -> str:
        return f"procedural_{self._seed}_{index:05d}"

    def category(self, index: int) -> str:
        return str(self.raw_mesh(index).metadata["family"])

    def raw_mesh(self, index: int) -> trimesh.Trimesh:
        return procedural_mesh(np.random.default_rng([self._seed, index]))


class ModelNetSubset(ShapeSource):
    """Stored ModelNet40 samples of one `.npz` file: 4,096 points a shape, in random order.

    Keys: `points` int16 (M, 4096, 3), `scale`, `name`, `cls`, `use`. Draws are without replacement;
    `points_pair` splits one draw, so its two clouds are disjoint.
    """

    def __init__(self, path: str | Path, *, use: str = "dev_eval") -> None:
        pack = _open_npz(path, ("points", "scale", "name", "cls", "use"))
        keep = pack["use"] == use
        if not keep.any():
            raise InputError(
                f"expected shapes with use {use!r}, found none in {path}; "
                f"there are: {sorted(set(pack['use']))}"
            )
        self._points, self._scale = pack["points"][keep], float(pack["scale"])
        self._name, self._category = pack["name"][keep], pack["cls"][keep]

    def __len__(self) -> int:
        return len(self._points)

    def name(self, index: int) -> str:
        return str(self._name[index])

    def category(self, index: int) -> str:
        return str(self._category[index])

    def points(
        self, index: int, count: int, rng: np.random.Generator
    ) -> Float[np.ndarray, "count 3"]:
        stored = self._points[index]
        if count > len(stored):
            raise InputError(
                f"expected at most {len(stored)} points of {self.name(index)}, got {count}; "
                "ask for fewer or use a mesh source"
            )
        return stored[rng.permutation(len(stored))[:count]] / self._scale

    def points_pair(
        self, index: int, count: int, rng: np.random.Generator
    ) -> tuple[Float[np.ndarray, "count 3"], Float[np.ndarray, "count 3"]]:
        sample = self.points(index, 2 * count, rng)
        return sample[:count], sample[count:]


def _open_npz(path: str | Path, keys: tuple[str, ...]) -> dict[str, np.ndarray]:
    try:
        with np.load(path) as archive:
            content = {key: archive[key] for key in archive.files}
    except (OSError, ValueError) as error:
        raise ReadError(f"expected a .npz pack at {path}, could not read it: {error}") from error
    missing = [key for key in keys if key not in content]
    if missing:
        raise ReadError(f"expected the keys {', '.join(keys)} in {path}, missing: {missing}")
    return content
