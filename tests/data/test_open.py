from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fullturn.data.frozen import FrozenPairs, freeze
from fullturn.data.official import ModelNet40Hdf5, OfficialModelNet40
from fullturn.data.open import open_pairs, open_shapes, protocol_pairs
from fullturn.data.procedural import demo_object
from fullturn.data.protocols import PROTOCOLS
from fullturn.data.shapes import MeshFolder, MeshPack, ProceduralShapes
from fullturn.data.stanford import StanfordScans
from fullturn.data.stored import ModelNetSubset
from fullturn.errors import InputError, ReadError


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with one of everything."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("FULLTURN_DATA", raising=False)
    mesh = demo_object()
    np.savez(
        "pack.npz",
        vertices=np.round(mesh.vertices * 20000).astype(np.int16),
        faces=mesh.faces.astype(np.uint16),
        vertex_offsets=np.array([0, len(mesh.vertices)]),
        face_offsets=np.array([0, len(mesh.faces)]),
        name=np.array(["pot"]),
        category=np.array(["pot"]),
        source=np.array(["a"]),
        split=np.array(["val"]),
    )
    np.savez(
        "modelnet.npz",
        points=np.ones((2, 4096, 3), dtype=np.int16),
        scale=np.int64(30000),
        name=np.array(["a", "b"]),
        cls=np.array(["chair", "vase"]),
        use=np.array(["dev_eval", "train"]),
    )
    (tmp_path / "meshes").mkdir()
    mesh.export("meshes/pot.ply")
    return tmp_path


def write_hdf5(path: str, **content: np.ndarray) -> None:
    h5py = pytest.importorskip("h5py", reason="needs h5py, of the extra data")
    with h5py.File(path, "w") as file:
        for key, value in content.items():
            file[key] = value


def test_shapes_are_told_apart_by_what_they_are() -> None:
    kinds = {"pack.npz": MeshPack, "modelnet.npz": ModelNetSubset, "meshes": MeshFolder}
    for spec, kind in kinds.items():
        assert type(open_shapes(spec)) is kind
    assert open_shapes("pack.npz:val").description["part"] == "val"
    assert open_shapes("modelnet.npz:train").name(0) == "b"
    assert open_shapes("modelnet.npz").name(0) == "a"


def test_generated_shapes_by_count_and_seed() -> None:
    for spec, count, seed in (
        ("procedural", 1000, 0),
        ("procedural:7", 7, 0),
        ("procedural:7:3", 7, 3),
    ):
        shapes = open_shapes(spec)
        assert isinstance(shapes, ProceduralShapes)
        assert (len(shapes), shapes.name(0)) == (count, f"procedural_{seed}_00000")


def test_hdf5_shapes(folder: Path) -> None:
    data, label = np.zeros((2, 2048, 3), np.float32), np.zeros(2, np.uint8)
    write_hdf5("train.h5", data=data, label=label)
    (folder / "hdf5").mkdir()
    write_hdf5("hdf5/ply_data_train0.h5", data=data, label=label)
    for spec in ("train.h5", "hdf5:train"):
        assert isinstance(open_shapes(spec), ModelNet40Hdf5)
    with pytest.raises(ReadError, match="ply_data_test"):
        open_shapes("hdf5")


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("absent.npz", r"expected FILE.npz\[:PART\].*absent.npz.*FULLTURN_DATA"),
        ("", "found nothing"),
        ("pack.npz:test", "expected meshes of split test.*splits: val"),
        ("modelnet.npz:test", "there are: dev_eval, train"),
        ("meshes:train", "expected no part"),
        ("other.npz", "found the keys a; it is a file of another kind"),
        ("notes.txt", "expected shapes as"),
        ("procedural:x", r"expected procedural\[:COUNT\[:SEED\]\]"),
        ("procedural:1:2:3", "procedural:200:7"),
        ("procedural:0", "count of at least 1"),
    ],
)
def test_what_cannot_be_opened_is_named(folder: Path, spec: str, message: str) -> None:
    np.savez("other.npz", a=np.zeros(3))
    (folder / "notes.txt").write_text("no shapes")
    with pytest.raises((InputError, ReadError), match=message):
        open_shapes(spec)


def test_paths_are_looked_for_below_the_data_folder(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "elsewhere").mkdir()
    monkeypatch.chdir(folder / "elsewhere")
    with pytest.raises(ReadError):
        open_shapes("pack.npz:val")
    monkeypatch.setenv("FULLTURN_DATA", str(folder))
    assert len(open_shapes("pack.npz:val")) == 1
    # What is here comes first.
    (folder / "elsewhere" / "meshes").mkdir()
    with pytest.raises(ReadError, match="expected mesh files"):
        open_shapes("meshes")


def test_pairs_are_told_apart_by_what_they_are(folder: Path) -> None:
    made = protocol_pairs(["rpmnet/45"], ProceduralShapes(2), count=1)[0][0]
    freeze(made, "frozen.npz")
    assert isinstance(open_pairs("frozen.npz"), FrozenPairs)
    assert open_pairs(folder / "frozen.npz").name == "rpmnet/45"
    (folder / "scans" / "pot").mkdir(parents=True)
    demo_object().export("scans/pot/a.ply")
    pose = np.eye(4).tolist()
    (folder / "scans/pot/poses.json").write_text(f'{{"a.ply": {pose}}}')
    (folder / "scans/pot/pairs.csv").write_text("source,target,overlap_min\na.ply,a.ply,1\n")
    assert isinstance(open_pairs("scans"), StanfordScans)
    for path in ("absent", "notes.txt", "frozen.npz:part"):
        (folder / "notes.txt").write_text("no pairs")
        with pytest.raises((InputError, ReadError), match=r"expected .*a frozen \.npz file"):
            open_pairs(path)


def test_published_pairs_by_their_words() -> None:
    cloud, label = np.zeros((2, 1024, 3), np.float32), np.array([0, 30])
    keys = [
        f"{e}_{s}_{n}"
        for e in ("partial", "complete")
        for s in ("src", "tgt")
        for n in ("noise", "clean")
    ]
    T = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    write_hdf5("test.h5", label=label, transforms=T, **dict.fromkeys(keys, cloud))
    for spec, name, count in (
        ("test.h5", "modelnet40/noisy/45", 768),
        ("test.h5:clean,unseen", "modelnet40/clean/45/unseen", 768),
        ("test.h5:complete", "modelnet40/noisy-complete/45", 1024),
    ):
        pairs = open_pairs(spec)
        assert isinstance(pairs, OfficialModelNet40)
        assert (pairs.name, len(pairs.pair(0).source)) == (name, count)
    with pytest.raises(InputError, match="noisy, clean, partial, complete, unseen"):
        open_pairs("test.h5:seen")


def test_all_stands_for_what_the_shapes_can_serve() -> None:
    stored = ModelNetSubset("modelnet.npz")
    sets, left_out = protocol_pairs(["all"], stored, count=2, seed=3)
    assert len(sets) + len(left_out) == len(PROTOCOLS)
    assert [line.split(" needs ")[0] for line in left_out] == [
        name for name in PROTOCOLS if name.startswith("mvp-rg") or PROTOCOLS[name].unseen
    ]
    assert all(pairs.description["seed"] == 3 for pairs in sets)
    served, none = protocol_pairs(["all"], ProceduralShapes(8), count=1)
    assert ([pairs.name for pairs in served], none) == (list(PROTOCOLS), [])


def test_named_protocols_must_be_served() -> None:
    stored = ModelNetSubset("modelnet.npz")
    names = ["rpmnet/45", "modelnet40/clean/180", "rpmnet/45"]
    sets, _ = protocol_pairs(names, ProceduralShapes(2), count=1)
    assert [pairs.name for pairs in sets] == names[:2]
    for wanted in (["mvp-rg"], ["all", "mvp-rg"]):
        with pytest.raises(InputError, match="mvp-rg needs meshes"):
            protocol_pairs(wanted, stored, count=1)
    with pytest.raises(InputError, match=r"out of all, modelnet40/clean/180, .*; got a, b;"):
        protocol_pairs(["b", "a"], stored, count=1)
    with pytest.raises(InputError, match="expected at least one protocol"):
        protocol_pairs([], stored, count=1)
    with pytest.raises(InputError, match="at least 1 pair"):
        protocol_pairs(["all"], stored, count=0)


def test_the_mixture_is_asked_for_by_name_and_needs_meshes() -> None:
    (mixture,), left_out = protocol_pairs(["mixture"], ProceduralShapes(3), count=2, seed=0)
    assert (mixture.name, len(mixture), left_out) == ("mixture", 2, [])
    sets, _ = protocol_pairs(["all"], ProceduralShapes(3), count=2, seed=0)
    assert "mixture" not in [one.name for one in sets]
    with pytest.raises(InputError, match="mixture needs meshes"):
        protocol_pairs(["mixture"], ModelNetSubset("modelnet.npz"), count=2, seed=0)
