"""Which pairs a run sees: the same whoever makes them, and none of validation's shapes."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from fullturn.data.pair import Pair
from fullturn.data.procedural import procedural_mesh
from fullturn.data.shapes import PACK_KEYS
from fullturn.data.view_pool import ViewPool
from fullturn.errors import InputError, ReadError
from fullturn.geometry.motion import move
from fullturn.normalize import normalized_clouds
from fullturn.training.batches import Steps, stream
from fullturn.training.config import DataConfig, ShapesConfig, ValidationConfig
from fullturn.training.pairs import RunPairs

DATA = DataConfig(
    shapes=(ShapesConfig("procedural:10:1"), ShapesConfig("procedural:5:2", share=0.25)),
    sample_points=32,
    cloud_points=24,
    batch=4,
)
VALIDATION = ValidationConfig(share=0.2)


def run_pairs(data: DataConfig = DATA, part: str = "training", **options: object) -> RunPairs:
    return RunPairs(data, VALIDATION, part=part, **options)  # type: ignore[arg-type]


def write_pack(path: Path) -> None:
    meshes = [procedural_mesh(np.random.default_rng([7, i])) for i in range(4)]
    content: dict[str, object] = {
        "vertices": np.concatenate([np.round(m.vertices * 30000) for m in meshes]).astype("i2"),
        "faces": np.concatenate([m.faces for m in meshes]).astype("u2"),
        "vertex_offsets": np.cumsum([0, *(len(m.vertices) for m in meshes)]),
        "face_offsets": np.cumsum([0, *(len(m.faces) for m in meshes)]),
        "name": np.array(list("abcd")),
        "category": np.array(["airplane", "chair", "sofa", "piano"]),
        "source": np.array(["free", "free", "other", "free"]),
        "split": np.array(["train"] * 4),
        "licence": np.array(["CC0", "CC-BY", "none", "CC0"]),
    }
    assert set(PACK_KEYS) <= content.keys()
    np.savez(path, **content)  # type: ignore[arg-type]


def test_a_pair_depends_on_its_number_alone() -> None:
    first, second = run_pairs(), run_pairs()
    for number in (0, 7, 1000):
        second.pair(number + 3)
        a, b = first.pair(number), second.pair(number)
        assert a.name == b.name
        assert np.array_equal(a.source, b.source)
        assert np.array_equal(a.T_target_source, b.T_target_source)
    assert not np.array_equal(first.pair(0).source, first.pair(1).source)


VIEWS = DataConfig(
    protocols=("mvp-rg", "mvp-rg-sensor"),
    shapes=(ShapesConfig("procedural:5:1"), ShapesConfig("procedural:4:2")),
    cloud_points=60,
)


def test_views_on_the_fly_depend_on_the_number_alone() -> None:
    def content(pair: Pair) -> bytes:
        return pair.source.tobytes() + pair.target.tobytes() + pair.T_target_source.tobytes()

    numbers = range(24)
    forth, back = run_pairs(VIEWS), run_pairs(VIEWS)
    first = {number: content(forth.pair(number)) for number in numbers}
    assert first == {number: content(back.pair(number)) for number in reversed(numbers)}
    assert first[11] == content(run_pairs(VIEWS).pair(11))
    assert len(set(first.values())) == len(numbers)
    assert content(run_pairs(replace(VIEWS, seed=1)).pair(11)) != first[11]
    # What workers are sent has no views in it.
    assert len(pickle.dumps(forth)) == len(pickle.dumps(run_pairs(VIEWS)))
    held_out = run_pairs(VIEWS, "validation")
    assert held_out.pair(2).source.shape == (60, 3)


def test_a_shape_without_two_views_makes_room_for_the_next(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    two_views, unfit = ViewPool.two_views, "procedural_1_00003"

    def sometimes(self: ViewPool, index: int, rng: np.random.Generator) -> object:
        if index == 3:
            raise InputError("no two views")
        return two_views(self, index, rng)

    one = replace(VIEWS, shapes=VIEWS.shapes[:1])
    everything = ValidationConfig(shapes=VIEWS.shapes[1:])
    before = [RunPairs(one, everything, part="training").name(number) for number in range(5)]
    monkeypatch.setattr(ViewPool, "two_views", sometimes)
    after = [RunPairs(one, everything, part="training").name(number) for number in range(5)]
    assert unfit in before
    assert unfit not in after
    assert sum(a != b for a, b in zip(before, after, strict=True)) == 1
    monkeypatch.setattr(ViewPool, "two_views", lambda self, index, rng: sometimes(self, 3, rng))
    with pytest.raises(InputError, match="no two views"):
        run_pairs(one).pair(0)


def test_clouds_come_as_a_method_sees_them() -> None:
    seen, made = (run_pairs(replace(DATA, frame=frame)).pair(3) for frame in ("method", "made"))
    source, target, _ = normalized_clouds(made.source, made.target)
    assert np.array_equal(seen.source, source.points)
    assert np.array_equal(seen.target, target.points)
    # Both poses say the same of the same points: clean pairs have exact copies.
    for pair in (seen, made):
        moved = move(pair.T_target_source, pair.source)
        nearest = cKDTree(pair.target).query(moved)[0]
        assert np.sum(nearest < 1e-9) >= 12
    assert np.abs(seen.source.mean(axis=0)).max() < 1e-12 < np.abs(made.source.mean(axis=0)).max()


def test_shapes_come_by_share_and_each_once_a_round() -> None:
    names = [run_pairs().pair(number).name for number in range(400)]
    from_second = np.mean([name.startswith("procedural_2") for name in names])
    assert 0.14 < from_second < 0.26
    one = DataConfig(shapes=(ShapesConfig("procedural:10:1"),), sample_points=9, cloud_points=6)
    pairs = run_pairs(one)
    rounds = [[pairs.pair(8 * turn + i).name for i in range(8)] for turn in range(3)]
    assert all(len(set(names)) == 8 for names in rounds)
    assert rounds[0] != rounds[1]


def test_validation_shows_other_shapes_whatever_the_seed() -> None:
    def shapes(part: str, seed: int) -> set[str]:
        data = DataConfig(shapes=DATA.shapes, sample_points=9, cloud_points=6, seed=seed)
        return {run_pairs(data, part).pair(number).name for number in range(120)}

    trained, held_out = shapes("training", 0), shapes("validation", 0)
    assert not trained & held_out
    assert held_out == shapes("validation", 5)
    assert len(trained) == 12
    assert len(held_out) == 3
    assert run_pairs().count == 12


def test_a_few_pairs_again_and_again() -> None:
    data = DataConfig(shapes=DATA.shapes, sample_points=9, cloud_points=6, count=3)
    pairs = run_pairs(data)
    assert np.array_equal(pairs.pair(1).source, pairs.pair(7).source)


def test_only_the_sources_and_classes_that_are_allowed(tmp_path: Path) -> None:
    write_pack(tmp_path / "pack.npz")
    place = ShapesConfig("pack.npz", part="train", sources=("free",))
    nothing_held_out = ValidationConfig(shapes=(ShapesConfig("procedural:3"),))
    seen = DataConfig(shapes=(place,), classes="seen", sample_points=9, cloud_points=6)
    pairs = RunPairs(seen, nothing_held_out, part="training", folder=tmp_path)
    assert {pairs.pair(number).name for number in range(20)} == {"a", "b"}
    (described,) = pairs.description
    assert described["license"] == "CC-BY; CC0"
    assert described["used"] == 2
    both = DataConfig(shapes=(place,), sample_points=9, cloud_points=6)
    pairs = RunPairs(both, nothing_held_out, part="training", folder=tmp_path)
    assert {pairs.pair(number).name for number in range(20)} == {"a", "b", "d"}


def test_missing_data_are_told(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match=r"modelnet40_ply_hdf5_2048.*FULLTURN_DATA"):
        run_pairs(DataConfig(shapes=(ShapesConfig("modelnet40_ply_hdf5_2048", "train"),))).pair(0)
    with pytest.raises(InputError, match="first 20 ModelNet40 classes in procedural"):
        run_pairs(DataConfig(shapes=(ShapesConfig("procedural:3"),), classes="seen")).pair(0)
    with pytest.raises(InputError, match="name more shapes"):
        run_pairs(DataConfig(shapes=(ShapesConfig("procedural:1"),))).pair(0)


def test_shapes_are_not_sent_to_workers() -> None:
    pairs = run_pairs()
    fresh = len(pickle.dumps(pairs))
    expected = pairs.pair(5)
    assert len(pickle.dumps(pairs)) == fresh
    assert np.array_equal(pickle.loads(pickle.dumps(pairs)).pair(5).source, expected.source)


def test_batches_are_shared_without_a_gap() -> None:
    whole = Steps(run_pairs(), 4)[3]
    parts = [Steps(run_pairs(), 4, rank=rank, size=2)[3] for rank in (0, 1)]
    assert whole.numbers == parts[0].numbers + parts[1].numbers == (12, 13, 14, 15)
    both = torch.cat([part.source.points for part in parts])
    assert torch.equal(whole.source.points, both)


def test_workers_change_nothing() -> None:
    steps = Steps(run_pairs(), 4)
    streams = [stream(steps, first=2, workers=count) for count in (0, 1, 2)]
    for _ in range(5):
        here, *there = [next(one) for one in streams]
        for other in there:
            assert other.numbers == here.numbers
            assert torch.equal(other.source.points, here.source.points)
            assert torch.equal(other.T_target_source, here.T_target_source)
    for one in streams:
        one.close()
