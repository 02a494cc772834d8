"""Read and write clouds, meshes and transforms by suffix; nothing here imports torch."""

from __future__ import annotations

from fullturn.io.load import LoadedCloud, load_cloud
from fullturn.io.save import save_cloud
from fullturn.io.transform import read_transform, write_transform

__all__ = ["LoadedCloud", "load_cloud", "read_transform", "save_cloud", "write_transform"]
