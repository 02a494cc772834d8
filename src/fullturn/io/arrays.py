"""Read points from NumPy files; pickled objects are never loaded."""

from __future__ import annotations

import io
import zipfile

import numpy as np

from fullturn.errors import ReadError, one_line
from fullturn.io.raw import Raw

_KEYS = ("points", "xyz", "positions", "vertices", "pos")


def read_npy(data: bytes, name: str) -> Raw:
    """The array of an NPY file.

    Raises:
        ReadError: another kind of file, truncated, objects inside, not of shape (N, 3).
    """
    if data[:6] != b"\x93NUMPY":
        raise ReadError(
            f"{name}: expected an NPY file, it begins with {one_line(data[:12])}; "
            "check the file or its suffix"
        )
    return Raw(_points(_parse(data, name), name))


def read_npz(data: bytes, name: str) -> Raw:
    """The array named points (or xyz, positions, vertices, pos) of an NPZ file, or its only one.

    Raises:
        ReadError: another kind of file, truncated, objects inside, none or several candidates.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            key = next((k for k in _KEYS if k in members), None)
            if key is None and len(members) == 1:
                key = next(iter(members))
            if key is None:
                raise ReadError(
                    f"{name}: expected an array named one of {', '.join(_KEYS)}, found "
                    f"{one_line(', '.join(members)) if members else 'none'}; rename one"
                )
            content = archive.read(members[key])
    except ReadError:
        raise
    # A damaged archive raises whatever its damage hits: zlib.error, struct.error, OSError, ...
    except Exception as error:
        raise ReadError(
            f"{name}: expected an NPZ file, cannot open it as one ({one_line(error)}); "
            "it is truncated, damaged or of another kind"
        ) from error
    return Raw(_points(_parse(content, name), name))


def _parse(data: bytes, name: str) -> np.ndarray:
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0
        if version != (1, 0):
            read = np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(stream)
    # A damaged header is parsed as Python text and fails in as many ways.
    except Exception as error:
        raise ReadError(
            f"{name}: cannot understand its NPY header ({one_line(error)}); it is damaged"
        ) from error
    if dtype.hasobject:
        raise ReadError(
            f"{name}: expected an array of numbers, found Python objects, which are never "
            "loaded; save it as a float array"
        )
    count = 1
    for side in shape:
        count *= int(side)
    body = data[stream.tell() :]
    if min(shape, default=0) < 0 or len(body) < count * dtype.itemsize:
        raise ReadError(
            f"{name}: expected {count * dtype.itemsize} bytes of data, {len(body)} came; "
            "the file is truncated or damaged"
        )
    if dtype.itemsize == 0:
        raise ReadError(f"{name}: expected an array of numbers, found dtype {one_line(dtype)}")
    array = np.frombuffer(body, dtype, count)
    return array.reshape(shape, order="F" if fortran else "C")


def _points(array: np.ndarray, name: str) -> np.ndarray:
    if array.dtype.kind not in "fiu" or array.ndim != 2 or array.shape[1] != 3:
        raise ReadError(
            f"{name}: expected an array of real numbers of shape (N, 3), found dtype "
            f"{one_line(array.dtype)} and shape {array.shape}; save it in that form"
        )
    return array
