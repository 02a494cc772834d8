"""The one way in: any file, array, tensor, cloud or mesh becomes finite float64 points."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fullturn.errors import InputError, ReadError, one_line, whole_number
from fullturn.io.arrays import read_npy, read_npz
from fullturn.io.check import as_points, check_pose, check_shape, precision_of
from fullturn.io.mesh import read_mesh, sample_surface
from fullturn.io.pcd import read_pcd
from fullturn.io.ply import read_ply
from fullturn.io.raw import Raw
from fullturn.io.text import read_text

if TYPE_CHECKING:
    import trimesh

SAMPLES = 20_000

_CLOUD_READERS: dict[str, Callable[[bytes, str], Raw]] = {
    ".ply": read_ply,
    ".pcd": read_pcd,
    ".xyz": read_text,
    ".txt": read_text,
    ".csv": read_text,
    ".tsv": read_text,
    ".asc": read_text,
    ".pts": read_text,
    ".npy": read_npy,
    ".npz": read_npz,
}
_MESHES_ALONE = (".obj", ".stl", ".off", ".glb")
MESH_SUFFIXES = (".ply", *_MESHES_ALONE)
SUFFIXES = (*_CLOUD_READERS, *_MESHES_ALONE)
_FEW_ZEROS = 0.01  # of the points: so many may lie in the origin
_ACCEPTED = (
    "a file path, an (N, 3) array, nested list or tensor, an object with .points or .vertices, "
    "or a mesh"
)


@dataclass(frozen=True, eq=False)
class LoadedCloud:
    """Points that passed every check, and what is worth telling about how they came in."""

    points: np.ndarray  # (N, 3) float64, finite, C-contiguous
    notes: tuple[str, ...] = ()  # for example dropped points or surface sampling
    name: str = "cloud"  # the file's name, or the role of an array


def load_cloud(
    path_or_object: Any, *, samples: int = SAMPLES, name: str | None = None
) -> LoadedCloud:
    """Read a file or take an object as a cloud of finite points (N, 3).

    Files: PLY, PCD, XYZ, TXT, CSV, TSV, ASC, PTS, NPY, NPZ; meshes OBJ, STL, OFF, GLB and PLY.
    Objects: arrays, nested lists, torch tensors of any device, anything with `.points` or
    `.vertices`. A mesh with faces is sampled: `samples` points uniform by area, the same in every
    run. NaN and infinite points in a *file* are missing returns: dropped, and counted in `notes`.
    In an *array* they are an error. `name` stands for an object in messages.

    >>> load_cloud([[0, 0, 0], [1, 0, 0], [0, 1, 0]]).points.dtype
    dtype('float64')

    Raises:
        InputError: an object of another type, shape or dtype; points that determine no pose.
        ReadError: a file that is missing, unreadable, truncated, mislabeled or of unknown kind.
    """
    samples = whole_number(samples, "samples", least=3)
    if isinstance(path_or_object, LoadedCloud):
        label = name or path_or_object.name
        points = as_points(path_or_object.points, label)
        return LoadedCloud(points, path_or_object.notes, label)
    if isinstance(path_or_object, (str, os.PathLike)):
        return _load_file(path_or_object, samples)
    return _load_object(path_or_object, samples, name or "cloud")


def read_raw(path: str | os.PathLike[str]) -> Raw:
    """What a file holds, before points are checked and surfaces sampled.

    Raises:
        ReadError: a file that is missing, unreadable, truncated, mislabeled or of unknown kind.
    """
    place = Path(path)
    name = one_line(place)
    suffix = place.suffix.lower()
    if not _exists(place, name):
        from_windows = "\\" in name and Path(str(place).replace("\\", "/")).is_file()
        advice = "write / for \\, and it is found" if from_windows else "check the path"
        raise ReadError(f"{name}: expected a file, there is none; {advice}")
    if not place.is_file():
        kind = "a folder" if place.is_dir() else "no regular file"
        raise ReadError(f"{name}: expected a file, it is {kind}; name a file")
    if suffix not in SUFFIXES:
        raise ReadError(
            f"{name}: expected a file name that ends in one of {', '.join(SUFFIXES)}, found "
            f"{one_line(suffix) if suffix else 'no suffix'}; rename or convert it"
        )
    try:
        data = place.read_bytes()
    except OSError as error:
        raise ReadError(
            f"{name}: cannot be read ({error.strerror}); check its permissions"
        ) from error
    if not data:
        raise ReadError(f"{name}: expected points, the file is empty; save or copy it again")
    if suffix in _MESHES_ALONE:
        return read_mesh(data, suffix, name)
    return _CLOUD_READERS[suffix](data, name)


def load_mesh(path: str | os.PathLike[str]) -> trimesh.Trimesh:
    """The mesh of a file, as it stands there.

    Raises:
        InputError: a file of points alone.
        ReadError: a file that is missing, unreadable, truncated, mislabeled or of unknown kind.
    """
    import trimesh

    name, suffix = one_line(path), Path(path).suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise ReadError(
            f"{name}: expected a mesh that ends in one of {', '.join(MESH_SUFFIXES)}, found "
            f"{one_line(suffix) if suffix else 'no suffix'}; rename or convert it"
        )
    raw = read_raw(path)
    if raw.faces is None or len(raw.faces) == 0:
        raise InputError(
            f"{name}: expected a mesh with triangles, found {len(raw.points)} points without any; "
            "give a mesh"
        )
    return trimesh.Trimesh(raw.points, raw.faces, process=False)


def _load_file(path: str | os.PathLike[str], samples: int) -> LoadedCloud:
    name, raw = one_line(path), read_raw(path)
    notes = list(raw.notes)
    if raw.faces is not None and len(raw.faces):
        points, missing = sample_surface(raw.points, raw.faces, samples=samples, name=name)
        notes.append(_sampled(name, len(points), len(raw.faces)))
        if missing:
            notes.append(f"{name}: left out {missing} triangles with NaN or infinite corners")
    else:
        finite = np.isfinite(raw.points).all(axis=1)
        points = raw.points[finite].astype(np.float64)
        if not finite.all():
            notes.append(
                f"{name}: dropped {int((~finite).sum())} of {len(finite)} points with NaN or "
                "infinite coordinates; matches count the points that stayed"
            )
        at_zero = int((points == 0.0).all(axis=1).sum())
        if at_zero > max(1, _FEW_ZEROS * len(points)):
            notes.append(
                f"{name}: {at_zero} of {len(points)} points lie at 0, 0, 0: missing returns? "
                "Remove them, if so"
            )
    check_pose(points, name, precision=precision_of(raw.points.dtype))
    return LoadedCloud(np.ascontiguousarray(points), tuple(notes), one_line(Path(path).name))


def mesh_parts(thing: Any) -> tuple[Any, Any] | None:
    """Vertices and faces of an object that is a mesh or a scene of some; None for any other."""
    thing = _of_scene(thing)
    faces = getattr(thing, "faces", getattr(thing, "triangles", None))
    if faces is None or not hasattr(thing, "vertices") or len(faces) == 0:
        return None
    return thing.vertices, faces


def _of_scene(thing: Any) -> Any:
    """The meshes of a trimesh.Scene as one; anything else as it is."""
    return thing.to_mesh() if hasattr(thing, "geometry") and hasattr(thing, "to_mesh") else thing


def _load_object(thing: Any, samples: int, name: str) -> LoadedCloud:
    thing = _of_scene(thing)
    mesh = mesh_parts(thing)
    if mesh is not None:
        corners, faces = mesh
        vertices = as_points(corners, name)
        points, _ = sample_surface(vertices, _triangles(faces, name), samples=samples, name=name)
        check_pose(points, name, precision=precision_of(np.asarray(corners).dtype))
        return LoadedCloud(points, (_sampled(name, len(points), len(faces)),), name)
    if _is_tensor(thing):
        thing = _tensor_values(thing, name)
    elif not isinstance(thing, (list, tuple, np.ndarray)) and not hasattr(thing, "__array__"):
        values = getattr(thing, "points", getattr(thing, "vertices", None))
        if values is None or callable(values):
            raise InputError(
                f"{name}: expected {_ACCEPTED}; got a {type(thing).__name__}; convert it"
            )
        thing = _tensor_values(values, name) if _is_tensor(values) else values
    return LoadedCloud(np.ascontiguousarray(as_points(thing, name)), (), name)


def _exists(place: Path, name: str) -> bool:
    try:
        place.stat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except (OSError, ValueError) as error:  # no permission, a name too long, a zero byte
        reason = getattr(error, "strerror", None) or one_line(error)
        raise ReadError(
            f"{name[:200]}: cannot be read ({reason}); check the path and its permissions"
        ) from error
    return True


def _sampled(name: str, points: int, triangles: int) -> str:
    return f"{name}: sampled {points} points on a mesh of {triangles} triangles"


def _triangles(faces: Any, name: str) -> np.ndarray:
    array = check_shape(faces, f"{name}.faces")
    if array.dtype.kind not in "iu":
        raise InputError(f"{name}: expected whole-number faces, found {array.dtype}")
    return array.astype(np.int64)


def _is_tensor(thing: Any) -> bool:
    # A tensor can only exist where torch has been imported already.
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(thing, torch.Tensor)


def _tensor_values(tensor: Any, name: str) -> np.ndarray:
    try:
        # bfloat16 has no NumPy twin; float32 holds it exactly.
        tensor = tensor.detach().to("cpu")
        if str(tensor.dtype) == "torch.bfloat16":
            tensor = tensor.float()
        values: np.ndarray = tensor.resolve_conj().resolve_neg().numpy()
    # Sparse, quantized and meta tensors each fail with their own error.
    except Exception as error:
        raise InputError(
            f"{name}: expected a dense tensor of real numbers, cannot read this one "
            f"({one_line(error)[:120]}); convert it to a dense float64 tensor"
        ) from error
    return values
