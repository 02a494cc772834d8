"""PLY: every encoding gives the same points, and damage is named."""

from __future__ import annotations

import io
import struct
import time
from pathlib import Path

import numpy as np
import pytest

from fullturn.errors import ReadError
from fullturn.io import load_cloud, save_cloud
from fullturn.io.ply import ply_bytes, read_ply

trimesh = pytest.importorskip("trimesh")


def header(encoding: str, count: int, *extra: str) -> bytes:
    lines = ["ply", f"format {encoding} 1.0", "comment made by a test", f"element vertex {count}"]
    lines += ["property float x", "property uchar red", "property double y", "property float z"]
    return "\n".join([*lines, *extra, "end_header", ""]).encode()


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32).astype(np.float64)


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_every_encoding_with_other_properties_between(encoding: str, points: np.ndarray) -> None:
    if encoding == "ascii":
        body = "".join(f"{x!r} 7 {y!r} {z!r}\n" for x, y, z in points.tolist()).encode()
    else:
        order = "<" if "little" in encoding else ">"
        body = b"".join(struct.pack(f"{order}fBdf", x, 7, y, z) for x, y, z in points)
    read = read_ply(header(encoding, len(points)) + body, "a.ply")
    np.testing.assert_array_equal(read.points, points)
    assert read.faces is None


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("sides", [[3, 3], [4, 4], [3, 4]])
def test_faces_become_triangle_fans(encoding: str, sides: list[int]) -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    polygons = [list(range(n)) for n in sides]
    extra = ("element face 2", "property list uchar int vertex_indices")
    if encoding == "ascii":
        body = "".join(f"{x} 0 {y} {z}\n" for x, y, z in corners)
        body += "".join(f"{len(p)} {' '.join(map(str, p))}\n" for p in polygons)
        data = body.encode()
    else:
        order = "<" if "little" in encoding else ">"
        data = b"".join(struct.pack(f"{order}fBdf", x, 0, y, z) for x, y, z in corners)
        data += b"".join(struct.pack(f"{order}B{len(p)}i", len(p), *p) for p in polygons)
    read = read_ply(header(encoding, 4, *extra) + data, "a.ply")
    assert read.faces is not None
    assert len(read.faces) == sum(n - 2 for n in sides)
    assert {tuple(f) for f in read.faces.tolist()} <= {(0, 1, 2), (0, 2, 3)}


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_strips_of_triangles(encoding: str, points: np.ndarray) -> None:
    strips = [[0, 1, 2, 3, -1, 4, 5, 6, -1, 7, -1], [7, 8, 9]]
    extra = ("element tristrips 2", "property list int int vertex_indices")
    if encoding == "ascii":
        body = "".join(f"{x!r} 7 {y!r} {z!r}\n" for x, y, z in points.tolist()).encode()
        body += "".join(f"{len(s)} {' '.join(map(str, s))}\n" for s in strips).encode()
    else:
        order = "<" if "little" in encoding else ">"
        body = b"".join(struct.pack(f"{order}fBdf", x, 7, y, z) for x, y, z in points)
        body += b"".join(struct.pack(f"{order}{len(s) + 1}i", len(s), *s) for s in strips)
    read = read_ply(header(encoding, len(points), *extra) + body, "a.ply")
    np.testing.assert_array_equal(read.points, points)
    assert read.faces is not None
    assert read.faces.tolist() == [[0, 1, 2], [2, 1, 3], [4, 5, 6], [7, 8, 9]]
    for empty in ([[0, 1, -1]] * 2, [[]] * 2):
        lines = "".join(f"{len(s)} {' '.join(map(str, s))}\n" for s in empty).encode()
        vertices = "0 0 0 0\n" * 50
        none = read_ply(header("ascii", 50, *extra) + vertices.encode() + lines, "a.ply")
        assert none.faces is not None
        assert len(none.faces) == 0


@pytest.mark.parametrize("encoding", ["binary", "ascii"])
def test_a_mesh_reads_as_trimesh_reads_it(encoding: str) -> None:
    sphere = trimesh.creation.icosphere(subdivisions=1)
    read = read_ply(sphere.export(file_type="ply", encoding=encoding), "a.ply")
    np.testing.assert_allclose(read.points, sphere.vertices, atol=1e-6)
    np.testing.assert_array_equal(read.faces, sphere.faces)


def test_a_cloud_that_open3d_wrote(tmp_path: Path, points: np.ndarray) -> None:
    o3d = pytest.importorskip("open3d")
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    for name, is_ascii in (("a.ply", False), ("b.ply", True)):
        o3d.io.write_point_cloud(str(tmp_path / name), cloud, write_ascii=is_ascii)
        np.testing.assert_allclose(load_cloud(tmp_path / name).points, points, atol=1e-5)


def test_trimesh_reads_what_is_written(points: np.ndarray) -> None:
    read = trimesh.load(io.BytesIO(ply_bytes(points)), file_type="ply")
    np.testing.assert_allclose(read.vertices, points)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d[: len(d) // 2], "truncated"),
        (lambda d: d[:40], "truncated"),
        (lambda d: b"0 0 0\n1 1 1\n", "expected a PLY file"),
        (lambda d: d.replace(b"element vertex", b"element wertex"), r"found \['wertex'\]"),
        (lambda d: d.replace(b"double z", b"double depth"), r"found \['depth', 'x', 'y'\]"),
        (lambda d: d.replace(b"property double z", b"property strange z"), "header line"),
        (lambda d: d.replace(b"property double z", b"property double y"), "twice"),
        (lambda d: d.replace(b"vertex 50", b"vertex -5"), "valid count"),
        (lambda d: d.replace(b"vertex 50", b"vertex 99999999999"), "expected 99999999999 rows"),
    ],
)
def test_damage_is_named(change: object, message: str, points: np.ndarray) -> None:
    with pytest.raises(ReadError, match=message):
        read_ply(change(ply_bytes(points)), "a.ply")  # type: ignore[operator]


def test_a_million_points_load_within_a_second_or_so(tmp_path: Path) -> None:
    cloud = np.random.default_rng(0).normal(size=(1_000_000, 3))
    save_cloud(tmp_path / "large.ply", cloud)
    begin = time.perf_counter()
    loaded = load_cloud(tmp_path / "large.ply")
    assert time.perf_counter() - begin < 3.0  # 0.3 s on a quiet machine
    np.testing.assert_array_equal(loaded.points, cloud)


def test_a_comment_may_say_end_header(points: np.ndarray) -> None:
    data = ply_bytes(points).replace(b"ply\n", b"ply\ncomment before end_header\n", 1)
    np.testing.assert_array_equal(read_ply(data, "a.ply").points, points)


@pytest.mark.parametrize("count", [np.nan, np.inf, -1.0])
@pytest.mark.parametrize("good", [0, 1])
def test_a_list_of_no_length_is_damage(count: float, good: int) -> None:
    head = header("binary_little_endian", 0, "element face 2", "property list float int corner")
    rows = struct.pack("<f3i", 3.0, 0, 1, 2) * good + struct.pack("<f3i", count, 0, 1, 2)
    with pytest.raises(ReadError, match="truncated or damaged"):
        read_ply(head + rows + struct.pack("<f3i", 3.0, 0, 1, 2), "a.ply")


@pytest.mark.parametrize("end", [b"\r", b"\r\n", b" \n"])
def test_header_lines_may_end_in_other_ways(end: bytes) -> None:
    points = np.full((5, 3), np.frombuffer(b"\n" * 8)[0])  # data that look like an end of a line
    head, body = ply_bytes(points).split(b"end_header\n")
    data = (head + b"end_header\n").replace(b"\n", end) + body
    np.testing.assert_array_equal(read_ply(data, "a.ply").points, points)
    rows = b"1 2 3\n4 5 6\n"
    text = head.replace(b"vertex 5", b"vertex 2").replace(b"binary_little_endian", b"ascii")
    text += b"end_header\n" + rows
    assert read_ply(text.replace(b"\n", end), "a.ply").points.tolist() == [[1, 2, 3], [4, 5, 6]]


def test_properties_may_be_capitals(points: np.ndarray) -> None:
    data = ply_bytes(points).replace(b"double x", b"double X").replace(b"double z", b"double Z")
    np.testing.assert_array_equal(read_ply(data, "a.ply").points, points)


def test_a_comment_may_hold_any_letters(points: np.ndarray) -> None:
    # In UTF-8, Å ends in 0x85, which is an end of a line in Unicode.
    data = ply_bytes(points).replace(b"ply\n", "ply\ncomment by Åsa\n".encode(), 1)
    np.testing.assert_array_equal(read_ply(data, "a.ply").points, points)
