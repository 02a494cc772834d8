"""What shipped weights are fit on: generated shapes, and meshes whose licenses allow it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from fullturn.data.shapes import MeshPack, MeshSource, ProceduralShapes

FREE_SOURCES = ("sweethome3d", "gazebo", "bullet_random")
_FORMS = 64
# What the cards of the weights say of it.
DATA = """\
- Data: shapes that our own generator makes, and meshes with a free licence (Sweet Home 3D: CC0 and
  CC-BY, by the contributors listed with its furniture libraries; Gazebo models: CC-BY, copyright
  2012 Nathan Koenig; Bullet's random objects: zlib). No ModelNet40 shape and no real scan.
- Licence: Apache-2.0, as the package."""


class Stretched(MeshSource):
    """Each mesh in 64 forms, stretched by up to e^±0.5 along its own or, of three in ten, any axes.

    They bear the name of the mesh: a split by shapes keeps them together.
    """

    def __init__(self, meshes: MeshSource) -> None:
        self._meshes = meshes

    def __len__(self) -> int:
        return len(self._meshes) * _FORMS

    def name(self, index: int) -> str:
        return self._meshes.name(index % len(self._meshes))

    def category(self, index: int) -> str:
        return self._meshes.category(index % len(self._meshes))

    def raw_mesh(self, index: int) -> trimesh.Trimesh:
        mesh = self._meshes.raw_mesh(index % len(self._meshes))
        rng = np.random.default_rng([7, index])
        turned = rng.random() < 0.3
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0] if turned else np.eye(3)
        stretch = axes * np.exp(rng.uniform(-0.5, 0.5, 3)) @ axes.T
        return trimesh.Trimesh(mesh.vertices @ stretch, mesh.faces, process=False)


def free_shapes(
    seed: int, data: str | None, *, meshes: int = 1, stretched: bool = False
) -> list[MeshSource]:
    """Generated shapes and, with the folder of the mesh packs, `meshes` times as many of those.

    If `stretched`, as many more that are stretched.
    """
    shapes: list[MeshSource] = [ProceduralShapes(100_000, seed=seed)]
    if data:
        pack = MeshPack(Path(data) / "meshes_open.npz", split="train", sources=FREE_SOURCES)
        shapes += [pack] * meshes + [Stretched(pack)] * stretched
    return shapes
