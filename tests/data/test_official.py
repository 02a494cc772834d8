"""Small files in the published form: what is read from them, and what is said of damaged ones."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fullturn.data.categories import MODELNET40_CLASSES
from fullturn.data.draw import ProtocolPairs
from fullturn.data.motion import axis_angle_rotation, ball_translation
from fullturn.data.official import ModelNet40Hdf5, OfficialModelNet40
from fullturn.data.protocols import PROTOCOLS
from fullturn.errors import DependencyError, InputError, ReadError
from fullturn.geometry.motion import move, rigid

LABELS = (3, 25, 19, 20, 39)


def write(path: Path, content: dict[str, Any]) -> None:
    h5py = pytest.importorskip("h5py", reason="needs h5py, of the extra data")
    with h5py.File(path, "w") as file:
        for key, value in content.items():
            file[key] = value


def content() -> dict[str, Any]:
    """Complete clouds of 1,100 points, partial ones of 800; noise moves points by 0.01 and less."""
    rng = np.random.default_rng(0)
    n = len(LABELS)
    T = np.array(
        [
            rigid(
                axis_angle_rotation(rng, max_angle_deg=180.0), ball_translation(rng, max_length=1)
            )
            for _ in range(n)
        ]
    )
    made: dict[str, Any] = {
        "data": rng.normal(size=(n, 2048, 3)),
        "transforms": T,
        "label": np.array(LABELS, dtype=np.int64)[:, None],
    }
    for extent, count in (("complete", 1100), ("partial", 800)):
        source = rng.normal(size=(n, count, 3))
        target = np.array([move(T[i], source[i]) for i in range(n)])
        for side, cloud in (("src", source), ("tgt", target)):
            made[f"{extent}_{side}_clean"] = cloud
            made[f"{extent}_{side}_noise"] = cloud + rng.uniform(-0.01, 0.01, cloud.shape)
    return {key: v.astype(np.float32) if key != "label" else v for key, v in made.items()}


@pytest.fixture
def released(tmp_path: Path) -> Path:
    path = tmp_path / "ModelNet40_test.h5"
    write(path, content())
    return path


def rows(points: np.ndarray) -> set[tuple[float, ...]]:
    return {tuple(point) for point in points}


@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("partial", [False, True])
def test_the_first_points_come_shuffled(released: Path, noisy: bool, partial: bool) -> None:
    pairs = OfficialModelNet40(released, noisy=noisy, partial=partial)
    stored, count = content(), 768 if partial else 1024
    noise, extent = "noise" if noisy else "clean", "partial" if partial else "complete"
    assert len(pairs) == 5
    for i in range(5):
        pair = pairs.pair(i)
        assert pair.source.dtype == np.float64
        for side, cloud in (("src", pair.source), ("tgt", pair.target)):
            wanted = stored[f"{extent}_{side}_{noise}"][i, :count].astype(np.float64)
            assert rows(cloud) == rows(wanted)
            assert not np.array_equal(cloud, wanted)
        assert np.array_equal(pair.T_target_source, stored["transforms"][i])
        assert pair.name == f"{MODELNET40_CLASSES[LABELS[i]]}_{i:05d}"


def test_the_truth_maps_source_to_target(released: Path) -> None:
    for pair in OfficialModelNet40(released, noisy=False):
        moved = np.sort(move(pair.T_target_source, pair.source), axis=0)
        assert np.allclose(moved, np.sort(pair.target, axis=0), atol=1e-5)


def test_pairs_depend_on_seed_and_number_alone(released: Path) -> None:
    first, again, other = (OfficialModelNet40(released, noisy=True, seed=s) for s in (0, 0, 1))
    unseen = OfficialModelNet40(released, noisy=True, unseen=True)
    assert first.pair(3).source.tobytes() == again.pair(3).source.tobytes()
    assert first.pair(3).source.tobytes() != other.pair(3).source.tobytes()
    # The numbers are those of the file, whichever classes are read.
    assert unseen.pair(1).source.tobytes() == first.pair(3).source.tobytes()


def test_unseen_are_the_last_20_classes(released: Path) -> None:
    unseen = OfficialModelNet40(released, noisy=True, unseen=True)
    names = [unseen.pair(i).name for i in range(len(unseen))]
    assert names == ["piano_00001", "laptop_00003", "xbox_00004"]
    assert unseen.name == "modelnet40/noisy/180/unseen"
    assert unseen.description["count"] == 3
    assert unseen.description["file"] == "ModelNet40_test.h5"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"transforms": None}, "missing: transforms; there are: complete_src_clean"),
        ({"partial_src_noise": np.zeros((5, 700, 3), np.float32)}, r"\(5, 768, 3\).*\(5, 700, 3\)"),
        ({"partial_tgt_noise": np.zeros((5, 800), np.float32)}, "partial_tgt_noise as floats"),
        ({"partial_tgt_noise": np.full((5, 800, 3), np.nan)}, "found NaN"),
        ({"transforms": np.eye(4, dtype=np.float32)}, r"shape \(4, 4\)"),
        ({"transforms": np.tile(2 * np.eye(4), (5, 1, 1))}, "number 0 is off by 7"),
        ({"transforms": np.tile(np.diag([1.0, 1, -1, 1]), (5, 1, 1))}, "expected rigid"),
        ({"label": np.array([0, 1, 2, 3, 40])}, "labels from 0 to 39, found int64 from 0 to 40"),
    ],
)
def test_other_content_is_named(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    changed = {key: v for key, v in {**content(), **change}.items() if v is not None}
    write(tmp_path / "test.h5", changed)
    with pytest.raises(ReadError, match=message):
        OfficialModelNet40(tmp_path / "test.h5", noisy=True)


def test_other_files_are_named(tmp_path: Path) -> None:
    pytest.importorskip("h5py", reason="needs h5py, of the extra data")
    (tmp_path / "text.h5").write_text("no HDF5")
    for name in ("text.h5", "absent.h5"):
        with pytest.raises(ReadError, match="expected an HDF5 file"):
            OfficialModelNet40(tmp_path / name, noisy=True)
    write(tmp_path / "seen.h5", {**content(), "label": np.zeros(5, dtype=np.uint8)})
    with pytest.raises(InputError, match="found none"):
        OfficialModelNet40(tmp_path / "seen.h5", noisy=True, unseen=True)


def test_without_h5py_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(DependencyError, match=r"fullturn\[data\]"):
        OfficialModelNet40(tmp_path / "test.h5", noisy=True)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rng = np.random.default_rng(1)
    for split, files in (("train", 1), ("test", 2)):
        for k in range(files):
            data = rng.uniform(-0.5, 0.5, (3, 2048, 3)).astype(np.float32)
            label = np.array([[k], [1], [2]], dtype=np.uint8)
            write(tmp_path / f"ply_data_{split}{k}.h5", {"data": data, "label": label})
    (tmp_path / "shape_names.txt").write_text("mug\npot\npan\n")
    return tmp_path


def test_the_standard_folder_is_a_source_of_shapes(folder: Path) -> None:
    shapes = ModelNet40Hdf5(folder)
    assert [shapes.category(i) for i in range(len(shapes))] == ["mug", "pot", "pan"] + [
        "pot"
    ] * 2 + ["pan"]
    assert shapes.name(4) == "pot_00004"
    assert len(ModelNet40Hdf5(folder, split="train")) == 3
    first, second = shapes.points_pair(5, 1024, np.random.default_rng(0))
    assert first.dtype == np.float64
    assert len(rows(first) | rows(second)) == 2048
    with pytest.raises(InputError, match="at most 2048 points"):
        shapes.points_pair(5, 1025, np.random.default_rng(0))
    pair = ProtocolPairs(PROTOCOLS["modelnet40/noisy/180"], shapes, count=1).pair(0)
    assert pair.source.shape == (768, 3)
    assert (
        shapes.description["sha256"] != ModelNet40Hdf5(folder, split="train").description["sha256"]
    )


def test_the_released_training_file_is_one_too(tmp_path: Path) -> None:
    stored = content()
    write(tmp_path / "ModelNet40_train.h5", {key: stored[key] for key in ("data", "label")})
    shapes = ModelNet40Hdf5(tmp_path / "ModelNet40_train.h5")
    assert [shapes.category(i) for i in range(5)] == [MODELNET40_CLASSES[k] for k in LABELS]
    assert rows(shapes.points(2, 2048, np.random.default_rng(0))) == rows(
        stored["data"][2].astype(np.float64)
    )


def test_other_folders_are_named(folder: Path) -> None:
    with pytest.raises(InputError, match="got 'val'"):
        ModelNet40Hdf5(folder, split="val")
    (folder / "ply_data_train0.h5").unlink()
    with pytest.raises(ReadError, match=r"expected files ply_data_train\*.h5"):
        ModelNet40Hdf5(folder, split="train")
    write(folder / "ply_data_train0.h5", {"data": np.zeros((2, 8, 3)), "label": np.zeros(3, int)})
    with pytest.raises(ReadError, match=r"data as floats of shape \(3, any, 3\)"):
        ModelNet40Hdf5(folder, split="train")
