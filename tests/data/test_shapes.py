from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fullturn.data.procedural import demo_object
from fullturn.data.shapes import MeshFolder, MeshPack, ProceduralShapes
from fullturn.data.solids import box
from fullturn.data.stored import ModelNetSubset
from fullturn.errors import InputError, ReadError


@pytest.fixture
def pack(tmp_path: Path) -> Path:
    meshes = [box((1, 0.5, 0.25)), demo_object(), box((1, 1, 1))]
    vertices = [np.round(mesh.vertices * 20000).astype(np.int16) for mesh in meshes]
    faces = [mesh.faces.astype(np.uint16) for mesh in meshes]
    path = tmp_path / "pack.npz"
    np.savez(
        path,
        vertices=np.concatenate(vertices),
        faces=np.concatenate(faces),
        vertex_offsets=np.cumsum([0] + [len(v) for v in vertices]),
        face_offsets=np.cumsum([0] + [len(f) for f in faces]),
        name=np.array(["brick", "teapot", "cube"]),
        category=np.array(["block", "pot", "block"]),
        source=np.array(["a", "b", "b"]),
        split=np.array(["train", "val", "train"]),
    )
    return path


@pytest.fixture
def modelnet(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    path = tmp_path / "modelnet.npz"
    np.savez(
        path,
        points=rng.integers(-15000, 15000, (3, 4096, 3)).astype(np.int16),
        scale=np.int64(30000),
        name=np.array(["chair_1", "vase_1", "chair_2"]),
        cls=np.array(["chair", "vase", "chair"]),
        use=np.array(["dev_eval", "dev_eval", "train"]),
    )
    return path


def test_pack_shows_only_the_chosen_meshes(pack: Path) -> None:
    assert [MeshPack(pack).name(i) for i in range(3)] == ["brick", "teapot", "cube"]
    train = MeshPack(pack, split="train", sources=["b"])
    assert [(train.name(i), train.category(i)) for i in range(len(train))] == [("cube", "block")]
    with pytest.raises(InputError, match="found none"):
        MeshPack(pack, split="test")


def test_points_fill_the_unit_ball_around_their_mean(pack: Path) -> None:
    shapes = MeshPack(pack)
    for i in range(len(shapes)):
        points = shapes.points(i, 20_000, np.random.default_rng(0))
        assert points.dtype == np.float64
        assert np.abs(points.mean(axis=0)).max() < 0.03
        assert np.linalg.norm(points, axis=1).max() == pytest.approx(1.0, abs=0.05)


def test_two_samples_share_the_frame_but_no_point(pack: Path, modelnet: Path) -> None:
    for shapes in (MeshPack(pack), ModelNetSubset(modelnet), ProceduralShapes(3)):
        first, second = shapes.points_pair(1, 1024, np.random.default_rng(0))
        assert len(first) == len(second) == 1024
        assert not {tuple(p) for p in first} & {tuple(p) for p in second}


def test_stored_points_are_drawn_without_replacement(modelnet: Path) -> None:
    shapes = ModelNetSubset(modelnet)
    assert len(shapes) == 2
    assert shapes.category(1) == "vase"
    everything = shapes.points(0, 4096, np.random.default_rng(0))
    assert len(np.unique(everything, axis=0)) == 4096
    assert np.abs(everything).max() <= 0.5
    with pytest.raises(InputError, match="at most 4096 points"):
        shapes.points(0, 5000, np.random.default_rng(0))
    with pytest.raises(InputError, match="dev_eval"):
        ModelNetSubset(modelnet, use="nothing")


def test_procedural_shapes_depend_on_seed_and_number_alone() -> None:
    few, many = ProceduralShapes(3, seed=5), ProceduralShapes(30, seed=5)
    rng = np.random.default_rng
    assert np.array_equal(few.points(2, 100, rng(0)), many.points(2, 100, rng(0)))
    assert few.category(2) == many.category(2)
    other = ProceduralShapes(3, seed=6).points(2, 100, rng(0))
    assert not np.array_equal(few.points(2, 100, rng(0)), other)


def test_folder_lists_meshes_by_path(tmp_path: Path) -> None:
    (tmp_path / "pots").mkdir()
    demo_object().export(tmp_path / "pots" / "teapot.ply")
    box((1, 1, 1)).export(tmp_path / "cube.obj")
    (tmp_path / "notes.txt").write_text("not a mesh")
    shapes = MeshFolder(tmp_path)
    assert [shapes.name(i) for i in range(len(shapes))] == ["cube", "pots/teapot"]
    assert [shapes.category(i) for i in range(len(shapes))] == ["", "pots"]
    assert shapes.points(1, 10, np.random.default_rng(0)).shape == (10, 3)


def test_unreadable_packs_are_named(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="expected mesh files"):
        MeshFolder(tmp_path)
    with pytest.raises(ReadError, match="could not read it"):
        MeshPack(tmp_path / "absent.npz")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(ReadError, match="missing"):
        ModelNetSubset(tmp_path / "other.npz")


def test_a_mesh_that_cannot_be_read_is_named_and_hidden_files_are_none(tmp_path: Path) -> None:
    box((1, 1, 1)).export(tmp_path / "cube.obj")
    (tmp_path / "._cube.obj").write_bytes(b"\x00\x05\x16\x07")
    (tmp_path / "back.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 5 5\n")
    (tmp_path / "torn.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\n")
    shapes = MeshFolder(tmp_path)
    assert [shapes.name(i) for i in range(len(shapes))] == ["back", "cube", "torn"]
    assert shapes.raw_mesh(0).faces.tolist() == [[0, 1, 2]]
    with pytest.raises(ReadError, match=r"torn\.ply: .* truncated"):
        shapes.raw_mesh(2)
