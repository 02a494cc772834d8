"""`.npz` files, read strictly and written reproducibly."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from fullturn.errors import ReadError, one_line


def open_npz(path: str | Path, keys: tuple[str, ...]) -> dict[str, np.ndarray]:
    """All arrays of a `.npz` file, which must hold `keys`.

    Raises:
        ReadError: no such file, not a `.npz` file, arrays of objects, or a key is missing.
    """
    with _archive(path) as archive:
        content = {key: archive[key] for key in archive.files}
    missing = [key for key in keys if key not in content]
    if missing:
        raise ReadError(
            f"expected the keys {', '.join(keys)} in {path}, missing: {', '.join(missing)}; "
            "it is a file of another kind"
        )
    return content


def npz_keys(path: str | Path) -> set[str]:
    """The keys of a `.npz` file, without reading the arrays."""
    with _archive(path) as archive:
        return set(archive.files)


def npz_bytes(arrays: dict[str, np.ndarray]) -> bytes:
    """The same bytes for the same arrays, on every machine."""
    # np.savez leaves the date of the members to the zip library; here it is always the same.
    # Nothing is compressed: noise doesn't shrink, and compressors differ between machines.
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for key, array in arrays.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, np.asarray(array, order="C"), allow_pickle=False)
            info = zipfile.ZipInfo(f"{key}.npy", (1980, 1, 1, 0, 0, 0))
            info.create_system, info.external_attr = 3, 0o644 << 16
            archive.writestr(info, member.getvalue())
    return stream.getvalue()


@contextmanager
def _archive(path: str | Path) -> Iterator[Any]:
    try:
        with open(path, "rb") as stream:
            if stream.read(2) != b"PK":
                raise ValueError("it is a file of another kind")
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as archive:
                yield archive
    # A damaged archive fails as OSError, ValueError, BadZipFile, EOFError, zlib.error, ...
    except Exception as error:
        raise ReadError(
            f"expected a .npz file at {path}, could not read it: {one_line(error)}; "
            "check the path, or copy the file again"
        ) from error
