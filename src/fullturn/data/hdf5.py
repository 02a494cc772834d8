"""HDF5 files of point clouds and poses, read strictly."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from fullturn.errors import DependencyError, ReadError, one_line

_RIGID = 1e-4  # the transforms are stored in single precision


@contextmanager
def open_hdf5(path: Path) -> Iterator[Any]:
    """An open file, for reading.

    Raises:
        DependencyError: h5py is missing.
        ReadError: there is no such file, or it is another kind of file.
    """
    try:
        import h5py
    except ImportError as error:
        raise DependencyError(
            f'reading {path} needs h5py; install it with: pip install "fullturn[data]"'
        ) from error
    try:
        with h5py.File(path, "r") as file:
            yield file
    except ReadError:
        raise
    except OSError as error:
        raise ReadError(
            f"expected an HDF5 file at {path}, cannot read it: {one_line(error)}; "
            "check the path, or download it again"
        ) from error


def read_arrays(
    path: Path, keys: tuple[str, ...], *, first: dict[str, int] | None = None
) -> dict[str, np.ndarray]:
    """The arrays of these keys; of those in `first`, only so many points a row."""
    with open_hdf5(path) as file:
        missing = [key for key in keys if key not in file or not hasattr(file[key], "shape")]
        if missing:
            raise ReadError(
                f"{path}: expected the keys {', '.join(keys)}, missing: {', '.join(missing)}; "
                f"there are: {', '.join(sorted(file)) or 'none'}; it is a file of another kind"
            )
        arrays: dict[str, np.ndarray] = {}
        for key in keys:
            count = (first or {}).get(key)
            whole = count is None or file[key].ndim != 3
            arrays[key] = file[key][...] if whole else file[key][:, :count]
        return arrays


def check_floats(path: Path, key: str, array: np.ndarray, shape: tuple[int | None, ...]) -> None:
    """ReadError where it isn't floats of this shape (None: any length), all finite."""
    fits = array.ndim == len(shape) and array.dtype.kind == "f"
    fits = fits and all(want in (None, got) for want, got in zip(shape, array.shape, strict=True))
    if not fits:
        wanted = ", ".join("any" if want is None else str(want) for want in shape)
        raise ReadError(
            f"{path}: expected {key} as floats of shape ({wanted}), found {array.dtype} of shape "
            f"{array.shape}; it is a file of another kind"
        )
    if not np.isfinite(array).all():
        raise ReadError(f"{path}: expected finite numbers in {key}, found NaN; download it again")


def check_rigid(path: Path, transforms: np.ndarray) -> None:
    """ReadError where a 4×4 transform isn't a rotation and a translation."""
    R = transforms[:, :3, :3]
    off = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    off = np.maximum(off, np.abs(np.linalg.det(R) - 1.0))
    off = np.maximum(off, np.abs(transforms[:, 3] - (0.0, 0.0, 0.0, 1.0)).max(axis=1))
    if off.max() > _RIGID:
        worst = int(off.argmax())
        raise ReadError(
            f"{path}: expected rigid transforms, number {worst} is off by {off[worst]:.2g}; "
            "download it again"
        )


def check_labels(path: Path, label: np.ndarray, classes: list[str]) -> np.ndarray:
    """The labels as integers; ReadError where they don't number the classes."""
    if (
        label.dtype.kind not in "iu"
        or label.size == 0
        or not 0 <= label.min() <= label.max() < len(classes)
    ):
        raise ReadError(
            f"{path}: expected labels from 0 to {len(classes) - 1}, found {label.dtype} "
            f"{'none' if label.size == 0 else f'from {label.min()} to {label.max()}'}; "
            "it is a file of another kind"
        )
    return label.astype(np.int64)
