"""Small files in the form of the published MVP-RG: what is read, and what is refused."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fullturn.data.motion import axis_angle_rotation, ball_translation, uniform_rotation
from fullturn.data.official import OfficialModelNet40
from fullturn.data.official_mvp import MVP_CLASSES, OfficialMvp
from fullturn.data.open import open_pairs
from fullturn.errors import DependencyError, InputError, ReadError
from fullturn.geometry.motion import invert, move, rigid

N, POINTS = 5, 30


def write(path: Path, content: dict[str, Any]) -> Path:
    h5py = pytest.importorskip("h5py", reason="needs h5py, of the extra data")
    with h5py.File(path, "w") as file:
        for key, value in content.items():
            if key == "match_id":
                group = file.create_group(key)
                for number, ids in enumerate(value):
                    group[str(number)] = ids
            else:
                file[key] = value
    return path


def for_training() -> dict[str, Any]:
    """Source and target are the same points in another order, so that poses can be checked."""
    rng = np.random.default_rng(0)
    source = rng.normal(size=(N, POINTS, 3)).astype(np.float32)
    return {
        "src": source,
        "tgt": source[:, rng.permutation(POINTS)],
        "complete": source,
        "cat_labels": np.array([0, 3, 15, 8, 3]),
        "match_level": np.array([0, 1, 1, 0, 1]),
        "match_id": [rng.integers(POINTS, size=7 + number) for number in range(N)],
    }


def for_testing() -> dict[str, Any]:
    rng, made = np.random.default_rng(1), for_training()
    pose_src = np.array(
        [rigid(uniform_rotation(rng), ball_translation(rng, max_length=0.5)) for _ in range(N)]
    )
    turn = [
        rigid(axis_angle_rotation(rng, max_angle_deg=45.0), ball_translation(rng, max_length=0.2))
        for _ in range(N)
    ]
    pose_tgt = np.array(turn) @ pose_src
    for side, pose in (("src", pose_src), ("tgt", pose_tgt)):
        moved = [move(pose[i], made[side][i].astype(float)) for i in range(N)]
        made[f"rotated_{side}"] = np.array(moved, dtype=np.float32)
        made[f"pose_{side}"] = pose.astype(np.float32)
    made["transforms"] = np.array(turn, dtype=np.float32)
    made["rot_level"] = np.array([0, 0, 1, 0, 1])
    return made


@pytest.fixture
def released(tmp_path: Path) -> Path:
    return write(tmp_path / "MVP_Test_RG.h5", for_testing())


def in_order(points: np.ndarray) -> np.ndarray:
    return points[np.lexsort(points.T)]


def test_the_transforms_take_sources_onto_targets(released: Path) -> None:
    pairs = OfficialMvp(released)
    assert (pairs.name, len(pairs)) == ("mvp-rg", N)
    for number, pair in enumerate(pairs):
        stored = for_testing()["rotated_src"][number]
        np.testing.assert_array_equal(in_order(pair.source), in_order(stored.astype(np.float64)))
        assert not np.array_equal(pair.source, stored)
        moved = move(pair.T_target_source, pair.source)
        np.testing.assert_allclose(in_order(moved), in_order(pair.target), atol=1e-5)
    assert pairs.pair(2).name == "skateboard_00002"
    assert [pairs.group(number) for number in range(N)] == [
        "match low, within 45°",
        "match high, within 45°",
        "match high, any rotation",
        "match low, within 45°",
        "match high, any rotation",
    ]
    assert pairs.description["part"] == "test"
    assert pairs.description["count"] == N
    assert str(released.parent) not in str(pairs.description)


def test_the_order_hangs_on_seed_and_number_alone(released: Path) -> None:
    one, same, other = OfficialMvp(released), OfficialMvp(released), OfficialMvp(released, seed=1)
    assert one.pair(3).source.tobytes() == same.pair(3).source.tobytes()
    assert one.pair(3).source.tobytes() != other.pair(3).source.tobytes()


@pytest.mark.parametrize("labels", ["cat_labels", "cat_label"])
def test_training_pairs_lie_in_one_frame(tmp_path: Path, labels: str) -> None:
    content = for_training()
    content[labels] = content.pop("cat_labels")
    pairs = OfficialMvp(write(tmp_path / "MVP_Train_RG.h5", content))
    assert (pairs.name, len(pairs)) == ("mvp-rg/train", N)
    for pair in pairs:
        np.testing.assert_array_equal(pair.T_target_source, np.eye(4))
        np.testing.assert_array_equal(in_order(pair.source), in_order(pair.target))
    assert pairs.pair(1).name == "chair_00001"
    assert pairs.group(1) == "match high, within 45°"


def test_only_what_is_needed_has_to_be_there(tmp_path: Path) -> None:
    content = for_testing()
    for key in ("src", "tgt", "complete", "match_id", "pose_src", "pose_tgt"):
        del content[key]
    assert len(OfficialMvp(write(tmp_path / "a.h5", content))) == N


def broken(**change: Any) -> dict[str, Any]:
    content = {**for_testing(), **change}
    return {key: value for key, value in content.items() if value is not None}


T = for_testing()["transforms"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (broken(rot_level=None), "missing: rot_level; there are: cat_labels, complete"),
        (broken(cat_labels=None), "missing: cat_labels"),
        (broken(transforms=None), r"published without its poses: use MVP_Test_RG\.h5"),
        (broken(transforms=T * 1.1), "expected rigid transforms, number"),
        (broken(transforms=T * [[[1], [1], [-1], [1]]]), "expected rigid transforms"),
        (broken(transforms=T[:3]), r"expected transforms as floats of shape \(5, 4, 4\)"),
        (broken(transforms=np.array([invert(one) for one in T])), "= pose_tgt · pose_src⁻¹"),
        (broken(pose_src=for_testing()["pose_tgt"]), "is off by .*another convention"),
        (broken(rotated_src=np.ones((N, POINTS, 2))), "expected rotated_src as floats"),
        (broken(rotated_src=np.float64(1.0)), "expected rotated_src as floats"),
        (broken(rotated_src=np.full((N, POINTS, 3), np.nan)), "expected finite numbers"),
        (broken(rotated_tgt=np.ones((3, POINTS, 3))), "expected 5 targets and labels"),
        (broken(cat_labels=np.array([0, 1])), "expected 5 targets and labels"),
        (broken(cat_labels=np.full(N, 16)), "expected labels from 0 to 15"),
        (broken(match_level=np.full(N, 2)), r"match_level as 5 values 0 or 1.*\[2\]"),
        (broken(rot_level=np.zeros(2, int)), "rot_level as 5 values"),
        ({"data": np.ones(3)}, "missing: rotated_src.*there are: data"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, content: dict[str, Any], message: str) -> None:
    with pytest.raises(ReadError, match=message):
        OfficialMvp(write(tmp_path / "a.h5", content))


def test_a_file_is_opened_by_its_keys(released: Path, tmp_path: Path) -> None:
    assert isinstance(open_pairs(released), OfficialMvp)
    assert open_pairs(write(tmp_path / "train.h5", for_training())).name == "mvp-rg/train"
    extra = {key: for_testing()[key] for key in ("rotated_src", "rotated_tgt", "cat_labels")}
    with pytest.raises(ReadError, match="without its poses"):
        open_pairs(write(tmp_path / "extra.h5", extra))
    turned = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    content: dict[str, Any] = {"label": np.array([3, 30]), "transforms": turned}
    content |= {f"partial_{side}_noise": np.zeros((2, 800, 3)) for side in ("src", "tgt")}
    path = write(tmp_path / "modelnet.h5", content)
    assert isinstance(open_pairs(path), OfficialModelNet40)
    with pytest.raises((InputError, ReadError), match="expected"):
        open_pairs(f"{released}:clean")


def test_what_cannot_be_read_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.h5").write_text("no data")
    with pytest.raises(ReadError, match="expected an HDF5 file"):
        OfficialMvp(tmp_path / "a.h5")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(DependencyError, match=r"fullturn\[data\]"):
        OfficialMvp(tmp_path / "a.h5")


def test_the_classes_are_sixteen() -> None:
    assert len(set(MVP_CLASSES)) == 16
