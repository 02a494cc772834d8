"""Read meshes, and sample points uniformly on a triangle mesh's surface."""

from __future__ import annotations

import io
import json
import logging
import re
import warnings
from typing import Any

import numpy as np

from fullturn.errors import InputError, ReadError, one_line
from fullturn.io.raw import Raw

_TRIANGLES = (4, 5)  # modes of GLB: one by one, or in strips


def read_mesh(data: bytes, suffix: str, name: str) -> Raw:
    """Vertices and triangles of an OBJ, STL, OFF or GLB file, scene transforms applied.

    An OBJ or OFF file without faces is a point cloud.

    Raises:
        ReadError: trimesh cannot read the file, or it holds no geometry.
    """
    if suffix == ".obj":
        data = _plain_obj(data)
    if suffix == ".stl":
        data = _whole_stl(data, name)
    if suffix == ".off" and (points := _off_cloud(data, name)) is not None:
        return _cloud(points, name)
    import trimesh

    logger = logging.getLogger("trimesh")
    level = logger.level
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            logger.setLevel(logging.CRITICAL)
            loaded: Any = trimesh.load(
                io.BytesIO(data),
                file_type=suffix[1:],
                force="mesh",
                process=False,
                skip_materials=True,
            )
            parts = _glb_parts(data) if suffix == ".glb" else []
            fractions = any(is_fraction for _, is_fraction in parts)
            is_single = suffix == ".stl" and len(data) == _stl_size(data)
            precision = np.float32 if is_single else np.float64
            vertices = np.array(loaded.vertices, dtype=precision).reshape(-1, 3)
            faces = np.array(loaded.faces, dtype=np.int64).reshape(-1, 3)
    # trimesh lets through whatever a damaged file provokes: KeyError, struct.error, JSON errors...
    except Exception as error:
        raise ReadError(
            f"{name}: cannot read it as {suffix[1:].upper()} "
            f"({type(error).__name__}: {one_line(error)[:120]}); "
            "it is truncated, damaged or of another kind"
        ) from error
    finally:
        logger.setLevel(level)
    if len(faces) == 0 and suffix == ".obj":
        return _cloud(_obj_vertices(data, name), name)
    if len(faces) == 0:
        raise ReadError(
            f"{name}: expected a mesh with triangles, found none; it is truncated or damaged, or a "
            "point cloud, which should be saved as PLY"
        )
    if suffix == ".glb" and not vertices.any():
        raise ReadError(
            f"{name}: expected a mesh, all {len(vertices)} vertices came out as 0, as those of "
            "compressed files do; save it without compression"
        )
    if fractions:
        raise ReadError(
            f"{name}: expected coordinates as they are, found whole numbers that stand for "
            "fractions (KHR_mesh_quantization, normalized); save it without quantization"
        )
    left_out = sum(mode not in _TRIANGLES for mode, _ in parts)
    note = f"{name}: left out points, lines or fans of triangles ({left_out} of {len(parts)} parts)"
    return Raw(vertices, faces, notes=(note,) if left_out else ())


def sample_surface(
    vertices: np.ndarray, faces: np.ndarray, *, samples: int, name: str
) -> tuple[np.ndarray, int]:
    """Points (samples, 3) uniform by area on a mesh, always the same ones, and faces left out.

    A triangle is drawn with probability proportional to its area; a point in it by the square
    root rule, p = (1 − √u) a + √u (1 − v) b + √u v c. Faces with a non-finite corner are left
    out and counted.

    Raises:
        InputError: faces that name no vertex, or no area at all.
    """
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise InputError(
            f"{name}: expected faces that index {len(vertices)} vertices, found indices from "
            f"{faces.min()} to {faces.max()}; the mesh is damaged"
        )
    corners = np.asarray(vertices, dtype=np.float64)[faces]  # (f, 3, 3)
    finite = np.isfinite(corners).all(axis=(1, 2))
    corners = corners[finite]
    extent = float(np.abs(corners).max(initial=0.0))
    if not 0.0 < extent < 1e150:
        raise InputError(
            f"{name}: expected a mesh with finite area, its largest coordinate is {extent:g}; "
            "check the file, or rescale it"
        )
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.linalg.norm(np.cross(first / extent, second / extent), axis=1)
    if not area.sum() > 0.0:
        raise InputError(
            f"{name}: expected a mesh with a surface, its {len(faces)} triangles have no area; "
            "check the file"
        )
    rng = np.random.default_rng(0)
    shares = np.cumsum(area) / area.sum()
    chosen = np.minimum(np.searchsorted(shares, rng.random(samples), side="right"), len(area) - 1)
    root = np.sqrt(rng.random((samples, 1)))
    along = rng.random((samples, 1))
    points = corners[chosen, 0] + root * ((1.0 - along) * first[chosen] + along * second[chosen])
    return points, int((~finite).sum())


def _glb_parts(data: bytes) -> list[tuple[int, bool]]:
    """The mode of each part of a GLB file, and whether its positions are normalized whole numbers.

    trimesh doesn't divide those, and leaves out parts of some modes.
    """
    tree = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    parts = [part for mesh in tree.get("meshes", ()) for part in mesh["primitives"]]
    return [
        (
            part.get("mode", _TRIANGLES[0]),
            bool(tree["accessors"][part["attributes"]["POSITION"]].get("normalized")),
        )
        for part in parts
    ]


def _plain_obj(data: bytes) -> bytes:
    """Without what trimesh stumbles over: a mark of UTF-8, tabs, old ends of lines, comments, and
    vertices of faces that count backwards from there, which it counts from the end of the file.
    """
    data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\t", b" ")
    data = re.sub(rb"#[^\n]*", b"", data.replace(b"\r\n", b"\n").replace(b"\r", b"\n"))
    if re.search(rb"^ *f.* (-|0\b)", data, re.MULTILINE) is None:
        return data
    lines, count = data.replace(b"\\\n", b" ").split(b"\n"), 0

    def forwards(corner: re.Match[bytes]) -> bytes:
        number = int(corner[1])
        if number < 0:
            number += count + 1
        return b" %d" % (number if number > 0 else len(data))  # for trimesh, 0 is the last one

    for at, line in enumerate(lines):
        kind = line.split(maxsplit=1)[:1]
        count += kind == [b"v"]
        if kind == [b"f"]:
            lines[at] = re.sub(rb" +(-?\d+)\S*", forwards, line)
    return b"\n".join(lines)


def _whole_stl(data: bytes, name: str) -> bytes:
    """The file without what follows the last triangle of a binary one, checked for its length."""
    # trimesh returns an empty mesh where the two differ.
    size = _stl_size(data)
    text = data[:4096].lower()
    if text.lstrip().startswith(b"solid") and b"facet" in text and len(data) != size:
        if b"endsolid" not in data.rstrip()[-1024:].lower():
            raise ReadError(f"{name}: the STL text has no 'endsolid'; the file is truncated")
        return data
    if len(data) < max(84, size):
        raise ReadError(
            f"{name}: expected a binary STL file of {size} bytes, {len(data)} came; "
            "it is truncated or of another kind"
        )
    return data[:size]


def _stl_size(data: bytes) -> int:
    """The length that a binary STL file says it has."""
    return 84 + 50 * int.from_bytes(data[80:84], "little")


def _cloud(points: np.ndarray, name: str) -> Raw:
    return Raw(points, notes=(f"{name}: no faces, its vertices are used",))


def _off_cloud(data: bytes, name: str) -> np.ndarray | None:
    """The vertices of an OFF file that announces no faces; of another one, only the check."""
    # trimesh ignores missing faces; counting numbers finds them however the lines are broken.
    words = b" ".join(line.split(b"#", 1)[0] for line in data.splitlines()).split()
    glued = re.fullmatch(rb"([A-Za-z0-9]*OFF)(\d+)", words[0]) if words else None
    if glued:  # as in some files of ModelNet: "OFF642 1280 0"
        words[:1] = glued.groups()
    try:
        if not words[0].endswith(b"OFF"):
            raise ValueError(words[0])
        vertices, faces = int(words[1]), int(words[2])
    except (IndexError, ValueError) as error:
        raise ReadError(
            f"{name}: expected OFF and the numbers of vertices, faces and edges, it begins with "
            f"{one_line(data[:20])}; it is truncated or of another kind"
        ) from error
    # Three coordinates per vertex; per face a count and three corners at least.
    if len(words) < 4 + 3 * vertices + 4 * faces:
        raise ReadError(
            f"{name}: expected {vertices} vertices and {faces} faces, the file ends before; "
            "it is truncated or damaged"
        )
    if faces != 0 or vertices <= 0:
        return None
    try:  # With colors or normals, a vertex has more numbers than three.
        return np.array(words[4:], dtype=np.float64).reshape(vertices, -1)[:, :3]
    except ValueError as error:
        raise ReadError(
            f"{name}: expected as many numbers for each of {vertices} vertices, found "
            f"{len(words) - 4} words; the file is damaged"
        ) from error


def _obj_vertices(data: bytes, name: str) -> np.ndarray:
    rows = [line.split()[1:4] for line in data.splitlines() if line.split()[:1] == [b"v"]]
    try:
        return np.array(rows, dtype=np.float64).reshape(-1, 3)
    except ValueError as error:
        raise ReadError(
            f"{name}: expected OBJ lines 'v x y z' with numbers; the file is damaged"
        ) from error
