"""What shipped weights are fit on: generated shapes, and meshes whose licenses allow it."""

from __future__ import annotations

from pathlib import Path

from fullturn.data.shapes import MeshPack, MeshSource, ProceduralShapes

FREE_SOURCES = ("sweethome3d", "gazebo", "bullet_random")
# What the cards of the weights say of it.
DATA = """\
- Data: shapes that our own generator makes, and meshes with a free licence (Sweet Home 3D: CC0 and
  CC-BY, by the contributors listed with its furniture libraries; Gazebo models: CC-BY, copyright
  2012 Nathan Koenig; Bullet's random objects: zlib). No ModelNet40 shape and no real scan.
- Licence: Apache-2.0, as the package."""


def free_shapes(seed: int, data: str | None, *, meshes: int = 1) -> list[MeshSource]:
    """Generated shapes and, with the folder of the mesh packs, `meshes` times as many of those."""
    shapes: list[MeshSource] = [ProceduralShapes(100_000, seed=seed)]
    if data:
        pack = MeshPack(Path(data) / "meshes_open.npz", split="train", sources=FREE_SOURCES)
        shapes += [pack] * meshes
    return shapes
