"""PCD: every encoding gives the same points, and LZF is undone exactly."""

from __future__ import annotations

import contextlib
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fullturn.errors import ReadError
from fullturn.io import load_cloud
from fullturn.io.pcd import lzf_decompress, read_pcd


def lzf_compress(data: bytes) -> bytes:
    """A slow compressor in the LZF format: literal runs, and references found by dictionary."""
    out, literals, seen, at = bytearray(), bytearray(), {}, 0

    def flush() -> None:
        for first in range(0, len(literals), 32):
            run = literals[first : first + 32]
            out.append(len(run) - 1)
            out.extend(run)
        literals.clear()

    while at < len(data):
        start = seen.get(data[at : at + 3])
        seen[data[at : at + 3]] = at
        if start is None or at - start > 8191 or at + 3 > len(data):
            literals.append(data[at])
            at += 1
            continue
        length = 3
        while (
            length < 263 and at + length < len(data) and data[start + length] == data[at + length]
        ):
            length += 1
        flush()
        distance, code = at - start - 1, length - 2
        if code < 7:
            out.append((code << 5) | (distance >> 8))
        else:
            out.extend([(7 << 5) | (distance >> 8), code - 7])
        out.append(distance & 255)
        at += length
    flush()
    return bytes(out)


def pcd(points: np.ndarray, encoding: str) -> bytes:
    count = len(points)
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS label x y z\nSIZE 2 4 8 4\nTYPE U F F F\n"
        f"COUNT 2 1 1 1\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\n"
        f"DATA {encoding}\n"
    ).encode()
    if encoding == "ascii":
        return header + "".join(f"5 6 {x!r} {y!r} {z!r}\n" for x, y, z in points.tolist()).encode()
    if encoding == "binary":
        return header + b"".join(struct.pack("<HHfdf", 5, 6, *p) for p in points)
    columns = struct.pack("<HH", 5, 6) * count
    columns += points[:, 0].astype("<f4").tobytes()
    columns += points[:, 1].astype("<f8").tobytes()
    columns += points[:, 2].astype("<f4").tobytes()
    packed = lzf_compress(columns)
    return header + struct.pack("<II", len(packed), len(columns)) + packed


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(60, 3)).astype(np.float32).astype(np.float64)


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_every_encoding_with_other_fields(encoding: str, points: np.ndarray) -> None:
    np.testing.assert_array_equal(read_pcd(pcd(points, encoding), "a.pcd").points, points)


@given(st.binary(max_size=300), st.integers(1, 40))
def test_lzf_round_trip(piece: bytes, repeats: int) -> None:
    data = piece * repeats
    assert lzf_decompress(lzf_compress(data), len(data)) == data


@given(st.binary(max_size=200), st.integers(0, 500))
def test_lzf_of_garbage_is_the_size_or_an_error(data: bytes, size: int) -> None:
    with contextlib.suppress(ValueError):
        assert len(lzf_decompress(data, size)) == size


@pytest.mark.parametrize(("is_ascii", "compressed"), [(True, False), (False, False), (False, True)])
def test_a_cloud_that_open3d_wrote(
    is_ascii: bool, compressed: bool, tmp_path: Path, points: np.ndarray
) -> None:
    o3d = pytest.importorskip("open3d")
    many = np.tile(points, (1700, 1))  # about 100,000 points
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(many))
    path = tmp_path / "a.pcd"
    o3d.io.write_point_cloud(str(path), cloud, write_ascii=is_ascii, compressed=compressed)
    begin = time.perf_counter()
    np.testing.assert_allclose(load_cloud(path).points, many, rtol=1e-6)
    assert time.perf_counter() - begin < 5.0


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
@pytest.mark.parametrize("keep", [0.2, 0.6, 0.95])
def test_truncation_is_named(encoding: str, keep: float, points: np.ndarray) -> None:
    data = pcd(points, encoding)
    with pytest.raises(ReadError, match=r"truncated|damaged"):
        read_pcd(data[: int(keep * len(data))], "a.pcd")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"FIELDS label x y z", b"FIELDS label a b c", "FIELDS x y z"),
        (b"SIZE 2 4 8 4", b"SIZE 2 4 8", "header"),
        (b"TYPE U F F F", b"TYPE U Q F F", "header"),
        (b"# .PCD", b"hello", "expected a PCD header line"),
        (b"POINTS 60", b"POINTS 99999999999", "expected 99999999999 points"),
    ],
)
def test_damage_is_named(old: bytes, new: bytes, message: str, points: np.ndarray) -> None:
    with pytest.raises(ReadError, match=message):
        read_pcd(pcd(points, "binary").replace(old, new), "a.pcd")


@pytest.mark.parametrize(("place", "noted"), [("0.0e+00 0 -0.", False), ("0 0 1e-3", True)])
def test_a_viewpoint_that_is_not_the_origin_is_noted(place: str, noted: bool) -> None:
    from fullturn.io.pcd import read_pcd

    header = (
        "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 1\nHEIGHT 1\n"
        f"VIEWPOINT {place} 1 0 0 0\nPOINTS 1\nDATA ascii\n1 2 3\n"
    )
    assert bool(read_pcd(header.encode(), "x").notes) == noted


def test_columns_is_the_old_name_of_fields(points: np.ndarray) -> None:
    data = pcd(points, "binary").replace(b"FIELDS", b"COLUMNS")
    np.testing.assert_array_equal(read_pcd(data, "a.pcd").points, points)
