"""Read PLY (ASCII and binary of both byte orders, clouds and meshes); write binary clouds."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass, field

import numpy as np

from fullturn.errors import ReadError, one_line
from fullturn.io.raw import Raw

_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class _Property:
    name: str
    dtype: str  # of the value, or of a list's items
    count_dtype: str | None = None  # of a list's length


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


def read_ply(data: bytes, name: str) -> Raw:
    """Vertices of a PLY file, and its faces (polygons as triangle fans, strips) if it has any.

    Raises:
        ReadError: not a PLY file, a damaged header, fewer data than the header promises.
    """
    order, elements, body = _read_header(data, name)
    columns: dict[str, dict[str, np.ndarray]] = {}
    rows = _AsciiRows(data[body:], name) if order == "" else None
    at = body
    for element in elements:
        if rows is not None:
            columns[element.name] = rows.take(element)
        else:
            columns[element.name], at = _read_binary(data, at, element, order, name)
    vertex = columns.get("vertex")
    if vertex is None or not {"x", "y", "z"} <= vertex.keys():
        raise ReadError(
            f"{name}: expected a PLY element 'vertex' with x, y and z, found "
            f"{one_line(sorted(vertex or columns))}; save the file again as a point cloud"
        )
    points = np.column_stack([vertex[axis] for axis in "xyz"])
    if points.dtype.kind not in "fiu":
        raise ReadError(f"{name}: expected numbers for x, y and z, found lists; save it again")
    triangles = []
    for kind, split in (("face", _fans), ("tristrips", _strips)):
        lists = columns.get(kind, {})
        corners = lists.get("vertex_indices", lists.get("vertex_index"))
        if corners is not None and len(corners):
            triangles.append(split(corners))
    return Raw(points, np.concatenate(triangles) if triangles else None)


def ply_bytes(points: np.ndarray) -> bytes:
    """A binary little-endian PLY of double-precision points (n, 3)."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(points)}\n"
        "property double x\nproperty double y\nproperty double z\nend_header\n"
    )
    return header.encode("ascii") + np.ascontiguousarray(points, dtype="<f8").tobytes()


def _read_header(data: bytes, name: str) -> tuple[str, list[_Element], int]:
    first = re.match(rb"ply[ \t]*(\r?\n|\r)", data)
    if first is None:
        raise ReadError(
            f"{name}: expected a PLY file (first line 'ply'), it begins with "
            f"{one_line(data[:12])}; check the file or its suffix"
        )
    # Where \r alone ends lines, a \n after it is data. Comments may hold the word, too.
    end = rb"\r" if first[1] == b"\r" else rb"\r?\n"
    last = re.search(rb"[\r\n]end_header[ \t]*" + end, data)
    if last is None:
        raise ReadError(f"{name}: the PLY header has no 'end_header'; the file is truncated")
    order: str | None = None
    elements: list[_Element] = []
    try:
        for line in data[: last.start()].splitlines()[1:]:  # letters may hold Unicode's line ends
            words = line.decode("latin-1").split()
            if not words or words[0] in ("comment", "obj_info"):
                continue
            if words[0] == "format":
                order = _FORMATS[words[1]]
            elif words[0] == "element":
                elements.append(_Element(words[1], int(words[2])))
            elif words[0] == "property" and words[1] == "list":
                item = _Property(words[4].lower(), _TYPES[words[3]], _TYPES[words[2]])
                elements[-1].properties.append(item)
            elif words[0] == "property":
                elements[-1].properties.append(_Property(words[2].lower(), _TYPES[words[1]]))
            else:
                raise ValueError(words[0])
    except (ValueError, IndexError, KeyError) as error:
        raise ReadError(
            f"{name}: cannot understand the PLY header line {one_line(repr(line))}; "
            "the file is damaged"
        ) from error
    names = [e.name for e in elements]
    repeated = any(len({p.name for p in e.properties}) < len(e.properties) for e in elements)
    if order is None or min((e.count for e in elements), default=-1) < 0:
        raise ReadError(f"{name}: the PLY header lacks a format or a valid count; it is damaged")
    if repeated or len(set(names)) < len(names):
        raise ReadError(f"{name}: the PLY header names an element or a property twice")
    return order, elements, last.end()


def _read_binary(
    data: bytes, at: int, element: _Element, order: str, name: str
) -> tuple[dict[str, np.ndarray], int]:
    """Columns of one element; lists of one common length are read as a block."""
    if element.count == 0 or not element.properties:
        return {p.name: np.zeros((0,)) for p in element.properties}, at
    layout: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    lengths: dict[str, int] = {}
    offset = at
    for prop in element.properties:
        if prop.count_dtype is None:
            layout.append((prop.name, order + prop.dtype))
            offset += int(prop.dtype[1])
            continue
        length = _length(data, offset, order + prop.count_dtype, name)
        if length < 0 or length > len(data):
            raise _truncated(name, element)
        lengths[prop.name] = length
        layout.append((f"# {prop.name}", order + prop.count_dtype))
        layout.append((prop.name, order + prop.dtype, (length,)))
        offset += int(prop.count_dtype[1]) + length * int(prop.dtype[1])
    record = np.dtype(layout)
    end = at + element.count * record.itemsize
    if end <= len(data):
        table = np.frombuffer(data, record, element.count, at)
        if all((table[f"# {key}"] == length).all() for key, length in lengths.items()):
            return {p.name: table[p.name] for p in element.properties}, end
    if not lengths:
        raise _truncated(name, element)
    return _read_ragged(data, at, element, order, name)


def _read_ragged(
    data: bytes, at: int, element: _Element, order: str, name: str
) -> tuple[dict[str, np.ndarray], int]:
    if element.count > len(data) - at:  # every row takes at least one byte
        raise _truncated(name, element)
    columns: dict[str, list[np.ndarray]] = {p.name: [] for p in element.properties}
    for _ in range(element.count):
        for prop in element.properties:
            length = 1
            if prop.count_dtype is not None:
                length = _length(data, at, order + prop.count_dtype, name)
                at += int(prop.count_dtype[1])
            step = length * int(prop.dtype[1])
            if length < 0 or at + step > len(data):
                raise _truncated(name, element)
            columns[prop.name].append(np.frombuffer(data, order + prop.dtype, length, at))
            at += step
    return {p.name: _column(p, columns[p.name]) for p in element.properties}, at


def _column(prop: _Property, rows: list[np.ndarray]) -> np.ndarray:
    if prop.count_dtype is None:
        return np.concatenate(rows) if rows else np.zeros((0,))
    column = np.empty(len(rows), dtype=object)
    column[:] = rows
    return column


class _AsciiRows:
    """The lines of an ASCII body, handed out element by element."""

    def __init__(self, body: bytes, name: str) -> None:
        self.lines = [line for line in body.splitlines() if line.strip()]
        self.name = name

    def take(self, element: _Element) -> dict[str, np.ndarray]:
        lines, self.lines = self.lines[: element.count], self.lines[element.count :]
        if len(lines) < element.count:
            raise _truncated(self.name, element)
        if not lines or not element.properties:
            return {p.name: np.zeros((0,)) for p in element.properties}
        try:
            if any(p.count_dtype is not None for p in element.properties):
                return self._lists(element, lines)
            text = io.StringIO(b"\n".join(lines).decode("latin-1"))
            width = range(len(element.properties))
            table = np.loadtxt(text, ndmin=2, usecols=width, comments=None)
        except (ValueError, IndexError, OverflowError) as error:
            raise ReadError(
                f"{self.name}: cannot read the PLY element {one_line(element.name)!r}: "
                f"{one_line(error)}; the file is damaged or truncated"
            ) from error
        return {p.name: table[:, i] for i, p in enumerate(element.properties)}

    def _lists(self, element: _Element, lines: list[bytes]) -> dict[str, np.ndarray]:
        columns: dict[str, list[np.ndarray]] = {p.name: [] for p in element.properties}
        for line in lines:
            words, at = line.split(), 0
            for prop in element.properties:
                length = 1
                if prop.count_dtype is not None:
                    length, at = int(words[at]), at + 1
                values = np.array(words[at : at + length], dtype="f8")
                if length < 0 or len(values) < length:
                    raise ValueError(f"line {one_line(line[:40])} is too short")
                columns[prop.name].append(values)
                at += length
        return {p.name: _column(p, columns[p.name]) for p in element.properties}


def _fans(corners: np.ndarray) -> np.ndarray:
    if corners.dtype != object:
        polygons = corners.astype(np.int64).reshape(len(corners), -1)
        return _fan(polygons)
    by_length: dict[int, list[np.ndarray]] = {}
    for polygon in corners:
        by_length.setdefault(len(polygon), []).append(polygon)
    return np.concatenate([_fan(np.stack(p).astype(np.int64)) for p in by_length.values()])


def _strips(rows: np.ndarray) -> np.ndarray:
    """Triangles of strips, in which each vertex makes one with the two before it; −1 ends one."""
    strips = np.concatenate([np.append(row, -1) for row in rows]).astype(np.int64)
    places = np.arange(len(strips))
    begin = np.maximum.accumulate(np.where(strips < 0, places + 1, 0))
    triangles = np.stack([strips[:-2], strips[1:-1], strips[2:]], axis=1)
    turned = (places - begin)[:-2] % 2 == 1  # every other one goes the other way round
    triangles[turned] = triangles[turned][:, [1, 0, 2]]
    return triangles[(triangles >= 0).all(axis=1)]


def _fan(polygons: np.ndarray) -> np.ndarray:
    """Triangles (0, i, i+1) of polygons (f, corners)."""
    corners = polygons.shape[1]
    triangles = [polygons[:, [0, i, i + 1]] for i in range(1, corners - 1)]
    return np.concatenate(triangles) if triangles else np.zeros((0, 3), dtype=np.int64)


def _length(data: bytes, at: int, dtype: str, name: str) -> int:
    """Of a list; −1 where a fraction's type holds no number."""
    if at + np.dtype(dtype).itemsize > len(data):
        raise ReadError(f"{name}: the PLY data end inside a list; the file is truncated")
    value = np.frombuffer(data, dtype, 1, at)[0]
    return int(value) if np.isfinite(value) else -1


def _truncated(name: str, element: _Element) -> ReadError:
    return ReadError(
        f"{name}: expected {element.count} rows of the PLY element {one_line(element.name)!r}, "
        "the file ends before; it is truncated or damaged, so save or copy it again"
    )
