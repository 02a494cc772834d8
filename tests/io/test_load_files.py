"""Text, NumPy and mesh files, and every way in which a file can be no file."""

from __future__ import annotations

import io
import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from fullturn.errors import FullturnError, InputError, ReadError
from fullturn.io import load_cloud, save_cloud
from fullturn.io.load import SUFFIXES, read_raw

trimesh = pytest.importorskip("trimesh")
POINTS = np.random.default_rng(0).normal(size=(40, 3))


def rows(separator: str, extra: str = "") -> str:
    return "".join(separator.join(f"{x:.17g}" for x in p) + extra + "\n" for p in POINTS)


@pytest.mark.parametrize(
    "text",
    [
        rows(" "),
        rows("\t"),
        rows(","),
        rows(";"),
        rows(", "),
        rows("   ", extra="   9 8"),
        rows(",", extra=",9,name of a point"),
        "x y z\n" + rows(" "),
        "# a comment\n\n" + rows(" ", extra=" # another"),
        "//X Y Z R\n" + rows(" ", extra=" 1"),
        '"x","y","z"\n' + rows(","),
        f"{len(POINTS)}\n" + rows(" "),
        "\ufeff" + rows(" "),
        rows(" ").replace("\n", "\r\n"),
        "i;z;y;x\n" + "".join(f"0;{z:.17g};{y:.17g};{x:.17g}\n" for x, y, z in POINTS),
    ],
)
@pytest.mark.parametrize("suffix", [".xyz", ".TXT", ".csv"])
def test_text_of_many_forms(text: str, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(text.encode())
    loaded = load_cloud(path)
    np.testing.assert_array_equal(loaded.points, POINTS)
    assert loaded.notes == ()
    assert loaded.name == path.name


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{len(POINTS) + 5}\n" + rows(" "), "announces 45 points, 40 came"),
        ("1 2\n3 4\n5 6\n", "three numbers per line"),
        ("1 2 3\n4 five 6\n7 8 9\n", "three numbers per line"),
        ("# nothing\n", "it is empty"),
        ("x y z\n", "it is empty"),
    ],
)
def test_text_that_holds_no_cloud(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    path.write_text(text)
    with pytest.raises(FullturnError, match=message):
        load_cloud(path)


@pytest.mark.parametrize(("zeros", "noted"), [(1, False), (2, True), (40, True)])
def test_many_points_in_the_origin_are_noted(zeros: int, noted: bool, tmp_path: Path) -> None:
    path = tmp_path / "organized.npy"
    save_cloud(path, np.concatenate([POINTS, np.zeros((zeros, 3))]))
    notes = load_cloud(path).notes
    assert any(f"{zeros} of {40 + zeros} points lie at 0, 0, 0" in note for note in notes) is noted


@pytest.mark.parametrize("suffix", [".ply", ".xyz", ".npy", ".csv"])
def test_missing_returns_are_dropped_and_counted(suffix: str, tmp_path: Path) -> None:
    holed = POINTS.copy()
    holed[3], holed[7, 1], holed[9, 2] = np.nan, np.inf, -np.inf
    path = tmp_path / f"a{suffix}"
    save_cloud(path, holed)
    loaded = load_cloud(path)
    np.testing.assert_array_equal(loaded.points, np.delete(POINTS, [3, 7, 9], axis=0))
    assert "dropped 3 of 40 points" in loaded.notes[0]
    save_cloud(path, np.full((5, 3), np.nan))
    with pytest.raises(InputError, match="it is empty"):
        load_cloud(path)


@pytest.mark.parametrize("dtype", ["f2", "f4", ">f4", "f8", "i4", "u1", "i8"])
def test_npy_of_every_real_type(dtype: str, tmp_path: Path) -> None:
    values = (POINTS * 50 + 120).astype(dtype)
    np.save(tmp_path / "a.npy", np.asfortranarray(values))
    loaded = load_cloud(tmp_path / "a.npy")
    np.testing.assert_array_equal(loaded.points, values.astype(np.float64))
    assert loaded.points.dtype == np.float64


def test_npz_by_key(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    for content in ({"points": POINTS, "x": 1}, {"only": POINTS}, {"vertices": POINTS, "faces": 1}):
        np.savez_compressed(path, **content)
        np.testing.assert_array_equal(load_cloud(path).points, POINTS)
    for content in ({"a": POINTS, "b": POINTS}, {}):
        np.savez(path, **content)
        with pytest.raises(ReadError, match="array named one of points, xyz"):
            load_cloud(path)


class Boom:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, ("false",)


def test_objects_are_never_unpickled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.save(tmp_path / "a.npy", np.array([Boom()] * 3, dtype=object), allow_pickle=True)
    np.savez(tmp_path / "a.npz", points=np.array([Boom()] * 3, dtype=object))
    (tmp_path / "b.npy").write_bytes(pickle.dumps(Boom()))

    def forbidden(*_: object, **__: object) -> None:
        raise AssertionError("unpickled")

    monkeypatch.setattr(pickle, "load", forbidden)
    monkeypatch.setattr(pickle, "loads", forbidden)
    for name in ("a.npy", "a.npz", "b.npy"):
        with pytest.raises(ReadError, match=r"Python objects|expected an NPY file"):
            load_cloud(tmp_path / name)


@pytest.mark.parametrize("shape", [(5, 2), (3, 7), (12,), (2, 5, 3), (0, 3), ()])
def test_npy_of_another_shape(shape: tuple[int, ...], tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.ones(shape))
    with pytest.raises(FullturnError, match=r"shape|it is empty"):
        load_cloud(tmp_path / "a.npy")


@pytest.mark.parametrize("kind", ["obj", "stl", "stl_ascii", "off", "glb", "ply"])
def test_meshes_are_sampled_on_their_surface(kind: str, tmp_path: Path) -> None:
    box = trimesh.creation.box(extents=(1.0, 2.0, 3.0))
    exported = box.export(file_type=kind)
    path = tmp_path / f"a.{kind.removesuffix('_ascii')}"
    path.write_bytes(exported if isinstance(exported, bytes) else exported.encode())
    loaded = load_cloud(path)
    assert loaded.points.shape == (20_000, 3)
    assert "sampled 20000 points on a mesh of 12 triangles" in loaded.notes[0]
    excess = np.abs(loaded.points) - np.array([0.5, 1.0, 1.5])
    np.testing.assert_allclose(excess.max(axis=1), 0.0, atol=1e-6)
    # Uniform by area: each pair of faces gets its share, within 5 standard deviations.
    shares = np.bincount(excess.argmax(axis=1), minlength=3) / 20_000
    np.testing.assert_allclose(shares, np.array([6, 3, 2]) / 11, atol=5 * (0.25 / 20_000) ** 0.5)
    np.testing.assert_array_equal(loaded.points, load_cloud(path).points)
    assert len(load_cloud(path, samples=500).points) == 500


def test_obj_without_faces_is_a_cloud(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in POINTS))
    loaded = load_cloud(tmp_path / "a.obj")
    np.testing.assert_allclose(loaded.points, POINTS)
    assert "its vertices are used" in loaded.notes[0]


@pytest.mark.parametrize("extra", ["", " 10 20 30 255"])
def test_off_without_faces_is_a_cloud(extra: str, tmp_path: Path) -> None:
    kind = "COFF" if extra else "OFF"
    path = tmp_path / "a.off"
    text = f"{kind}\n# a comment\n{len(POINTS)} 0 0\n{rows(' ', extra)}"
    path.write_text(text)
    loaded = load_cloud(path)
    np.testing.assert_array_equal(loaded.points, POINTS)
    assert "its vertices are used" in loaded.notes[0]
    for damaged in (text[: len(text) // 2], text + "1 2\n", text.replace(".", "x", 1)):
        path.write_text(damaged)
        with pytest.raises(ReadError, match=r"the file ends before|the file is damaged"):
            load_cloud(path)
    path.write_text("OFF\n0 0 0\n")
    with pytest.raises(ReadError, match="expected a mesh with triangles"):
        load_cloud(path)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "off", "glb"])
@pytest.mark.parametrize("keep", [0.0, 0.1, 0.5, 0.9])
def test_truncated_meshes_are_named(kind: str, keep: float, tmp_path: Path) -> None:
    exported = trimesh.creation.box().export(file_type=kind)
    data = exported if isinstance(exported, bytes) else exported.encode()
    path = tmp_path / f"a.{kind.removesuffix('_ascii')}"
    path.write_bytes(data[: int(keep * len(data))])
    with pytest.raises(ReadError) as caught:
        load_cloud(path)
    assert "\n" not in str(caught.value)


def test_mesh_without_area_or_with_wrong_faces(tmp_path: Path) -> None:
    path = tmp_path / "a.off"
    path.write_text("OFF\n3 1 0\n0 0 0\n1 1 1\n2 2 2\n3 0 1 2\n")
    with pytest.raises(InputError, match="no area"):
        load_cloud(path)
    path = tmp_path / "b.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n"
    )
    with pytest.raises(InputError, match="index 3 vertices"):
        load_cloud(path)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0", b"hello\nyou\n"])
def test_empty_and_mislabeled_files_of_every_suffix(
    suffix: str, content: bytes, tmp_path: Path
) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(content)
    with pytest.raises(FullturnError) as caught:
        load_cloud(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_file_at_all(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="there is none"):
        load_cloud(tmp_path / "missing.ply")
    with pytest.raises(ReadError, match="a folder"):
        load_cloud(tmp_path)
    (tmp_path / "file.ply").write_bytes(b"x")
    with pytest.raises(ReadError, match="there is none"):
        load_cloud(tmp_path / "file.ply" / "inside.ply")
    with pytest.raises(ReadError, match="cannot be read"):
        load_cloud("zero\0byte.ply")
    with pytest.raises(ReadError, match="cannot be read"):
        load_cloud("long" * 2000 + ".ply")
    os.mkfifo(tmp_path / "pipe.ply")
    with pytest.raises(ReadError, match="no regular file"):
        load_cloud(tmp_path / "pipe.ply")


@pytest.mark.skipif(os.sep == "\\", reason="where both separate")
def test_a_path_of_windows_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "scans").mkdir()
    np.save(tmp_path / "scans" / "a.npy", POINTS)
    with pytest.raises(ReadError, match=r"there is none; write / for \\, and it is found"):
        load_cloud(f"{tmp_path}/scans\\a.npy")
    with pytest.raises(ReadError, match="there is none; check the path"):
        load_cloud(f"{tmp_path}/scans\\b.npy")


def test_unknown_suffix_lists_the_known_ones(tmp_path: Path) -> None:
    for name in ("a.docx", "a"):
        (tmp_path / name).write_bytes(b"x")
        with pytest.raises(ReadError) as caught:
            load_cloud(tmp_path / name)
        assert all(suffix in str(caught.value) for suffix in SUFFIXES)


def test_no_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.npy"
    np.save(path, POINTS)

    def denied(self: Path) -> bytes:
        raise PermissionError(13, "Permission denied")

    # Not by chmod: the superuser reads everything.
    monkeypatch.setattr(Path, "read_bytes", denied)
    with pytest.raises(ReadError, match="Permission denied"):
        load_cloud(path)


@pytest.mark.parametrize("samples", [0, 2, -5, 1.5, True, "many"])
def test_samples_must_be_a_count(samples: object) -> None:
    with pytest.raises(InputError, match="samples"):
        load_cloud(POINTS, samples=samples)  # type: ignore[arg-type]


def test_npy_in_fortran_order_of_version_2(tmp_path: Path) -> None:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asfortranarray(POINTS), version=(2, 0))
    (tmp_path / "a.npy").write_bytes(stream.getvalue())
    np.testing.assert_array_equal(load_cloud(tmp_path / "a.npy").points, POINTS)


def test_off_may_have_its_counts_on_the_first_line(tmp_path: Path) -> None:
    path = tmp_path / "a.off"
    corners = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
    faces = "3 0 1 2\n3 0 1 3\n3 0 2 3\n3 1 2 3\n"
    for first in ("OFF4 4 0", "OFF\n4 4 0"):
        path.write_text(f"{first}\n{corners}{faces}")
        loaded = load_cloud(path)
        assert "4 triangles" in loaded.notes[0]
    path.write_text(f"OFF4 0 0\n{corners}")
    assert len(load_cloud(path).points) == 4


def test_npy_of_a_negative_shape(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.ones((50, 3)))
    data = (tmp_path / "a.npy").read_bytes().replace(b"(50, 3)", b"(-5,-3)")
    (tmp_path / "a.npy").write_bytes(data)
    with pytest.raises(ReadError, match="damaged"):
        load_cloud(tmp_path / "a.npy")


TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"


@pytest.mark.parametrize(
    "text",
    [
        "\ufeff" + TETRAHEDRON,
        "\ufeff# a comment\n" + TETRAHEDRON,
        TETRAHEDRON.replace(" ", "\t"),
        TETRAHEDRON.replace("\n", "\r"),
        TETRAHEDRON.replace("\n", " # a comment \\\n"),
        TETRAHEDRON.replace("1 2 3", "1 \\\n2 3").replace("\n", "\r\n"),
    ],
)
def test_obj_of_many_forms(text: str, tmp_path: Path) -> None:
    plain, path = tmp_path / "plain.obj", tmp_path / "a.obj"
    plain.write_text(TETRAHEDRON)
    path.write_bytes(text.encode())
    np.testing.assert_array_equal(load_cloud(path).points, load_cloud(plain).points)


BINARY_STL = trimesh.creation.box().export(file_type="stl")
STL = trimesh.creation.box().export(file_type="stl_ascii").encode()


@pytest.mark.parametrize(
    ("data", "same"),
    [
        (BINARY_STL + b"more", BINARY_STL),
        (b"solid, one facet after the other".ljust(80) + BINARY_STL[80:], BINARY_STL),
        (STL.upper(), STL),
        (b"\n" + STL + b"\n" * 2000, STL),
        (STL.replace(b"solid", b"solid" + b" of a long name" * 100, 1), STL),
    ],
)
def test_stl_of_many_forms(data: bytes, same: bytes, tmp_path: Path) -> None:
    for name, content in (("a.stl", data), ("same.stl", same)):
        (tmp_path / name).write_bytes(content)
    found, expected = (load_cloud(tmp_path / name).points for name in ("a.stl", "same.stl"))
    np.testing.assert_array_equal(found, expected)


def test_stl_that_is_too_far_out_for_its_precision_is_named(tmp_path: Path) -> None:
    box = trimesh.creation.box().apply_translation([1e7, 0, 0])
    (tmp_path / "a.stl").write_bytes(box.export(file_type="stl"))
    with pytest.raises(InputError, match=r"a\.stl: expected points that span .* in steps of up to"):
        load_cloud(tmp_path / "a.stl")
    (tmp_path / "a.stl").write_text(box.export(file_type="stl_ascii"))
    assert len(load_cloud(tmp_path / "a.stl", samples=50).points) == 50


def test_off_that_does_not_say_so_is_refused(tmp_path: Path) -> None:
    # Read one number too far, it would be a cloud: 20 vertices and no faces.
    (tmp_path / "a.off").write_text("40 20 0\n" + rows(" ") + "3 0 1 2\n" * 20)
    with pytest.raises(ReadError, match="expected OFF and the numbers"):
        load_cloud(tmp_path / "a.off")


@pytest.mark.parametrize("corner", ["{}", "{}/1", "{}//-1", "{}/-1/-1"])
def test_faces_of_obj_may_count_vertices_backwards(corner: str, tmp_path: Path) -> None:
    text = ""
    for x in (0, 5):
        text += f"v {x} 0 0\nv {x + 1} 0 0\nv {x} 1 0\nvt 0 0\nvn 0 0 1\n"
        text += f"f {corner.format(-3)} {corner.format(-2)} \\\n{corner.format(-1)}\n"
    for first in (1, "-6"):  # an absolute one between them
        (tmp_path / "a.obj").write_text(f"{text}f {first} 2 -1\n")
        faces = read_raw(tmp_path / "a.obj").faces
        assert faces is not None
        assert {tuple(face) for face in faces.tolist()} == {(0, 1, 2), (3, 4, 5), (0, 1, 5)}
    for none in ("-9 -1 -2", "0 1 2"):
        (tmp_path / "a.obj").write_text(f"{text}f {none}\n")
        with pytest.raises(ReadError, match="damaged"):
            load_cloud(tmp_path / "a.obj")


def test_points_beside_a_mesh_are_left_out_with_a_note(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    scene = trimesh.Scene([trimesh.creation.box(), trimesh.PointCloud(POINTS + 10)])
    path.write_bytes(scene.export(file_type="glb"))
    cloud = load_cloud(path, samples=50)
    assert np.abs(cloud.points).max() <= 0.5
    assert f"{path}: left out points, lines or fans of triangles (1 of 2 parts)" in cloud.notes


def test_a_glb_file_without_a_readable_mesh_says_what_to_do(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    path.write_bytes(trimesh.Scene(trimesh.PointCloud(POINTS)).export(file_type="glb"))
    with pytest.raises(ReadError, match="or a point cloud, which should be saved as PLY"):
        load_cloud(path)
    data = trimesh.creation.box().export(file_type="glb")
    assert b'"byteOffset":0,' in data  # is said where it need not be, in as many letters
    path.write_bytes(data.replace(b'"byteOffset":0,', b'"normalized":1,'))
    with pytest.raises(ReadError, match="save it without quantization"):
        load_cloud(path)
    # Where nothing decompresses them, accessors without a buffer are zero.
    assert data.count(b'"bufferView":1') == 1
    path.write_bytes(data.replace(b'"bufferView":1', b'"bufferVoid":1'))
    with pytest.raises(ReadError, match="save it without compression"):
        load_cloud(path)
