"""Built MVP-RG sets: what their pairs promise, and what is left of damaged ones."""

from __future__ import annotations

import json
import os
import pickle
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from fullturn.data import mvp_pair
from fullturn.data.mvp_build import build_mvp_rg, one_after_the_other
from fullturn.data.mvp_pair import PairMaker, Task
from fullturn.data.mvp_rg import MvpRgConfig, MvpRgPairs
from fullturn.data.mvp_shapes import Shape, schedule, split_shapes
from fullturn.data.open import open_pairs
from fullturn.data.overlap import scan_overlap
from fullturn.data.sensor import Sensor
from fullturn.data.shapes import MeshSource, ProceduralShapes
from fullturn.errors import FullturnError, InputError, ReadError, WriteError
from fullturn.geometry.motion import move

SMALL = MvpRgConfig(train=5, test=3, points=150, resolution=32, views=10, shard=2, seed=3)
SHAPES = ProceduralShapes(12, seed=5)


class Meshes(MeshSource):
    """Meshes by name; one that is an error is raised."""

    def __init__(self, **meshes: trimesh.Trimesh | Exception) -> None:
        self._names, self._meshes = list(meshes), list(meshes.values())

    def __len__(self) -> int:
        return len(self._names)

    def name(self, index: int) -> str:
        return self._names[index]

    def category(self, index: int) -> str:
        return self._names[index].partition("_")[0]

    def raw_mesh(self, index: int) -> trimesh.Trimesh:
        mesh = self._meshes[index]
        if isinstance(mesh, Exception):
            raise mesh
        return mesh


def mesh_of(vertices: Any, faces: Any) -> trimesh.Trimesh:
    return trimesh.Trimesh(np.array(vertices, float), np.array(faces), process=False)


def sphere() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=3, radius=0.02)


def made(source: MeshSource, config: MvpRgConfig, count: int, split: str = "train") -> list[Any]:
    maker = PairMaker(replace(config, train=count), [source], [source_of("spare")])
    return [maker(Task(split, number)) for number in range(count)]


def source_of(*names: str) -> Meshes:
    return Meshes(**{name: sphere() for name in names})


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sets") / "built"
    build_mvp_rg([SHAPES], out, SMALL)
    return out


@pytest.fixture
def copied(built: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(built, tmp_path / "set"))


def fitted_center(points: np.ndarray) -> np.ndarray:
    """Of a sphere through points: |p|² = 2 p·c + d."""
    A = np.column_stack([2.0 * points, np.ones(len(points))])
    return np.linalg.lstsq(A, (points**2).sum(axis=1), rcond=None)[0][:3]


def test_a_sphere_is_seen_from_where_the_viewpoints_say() -> None:
    for pair in made(source_of("a", "b"), SMALL, 4):
        ends = (pair.source, pair.source_viewpoint), (pair.target, pair.target_viewpoint)
        centers = []
        for points, eye in ends:
            points = points.astype(np.float64)
            center = fitted_center(points)
            np.testing.assert_allclose(np.linalg.norm(points - center, axis=1), 1.0, atol=0.02)
            assert np.linalg.norm(eye - center) == pytest.approx(3.0, abs=0.02)
            # The rays that touch the sphere do so where the cosine is 1/3.
            assert ((points - center) @ (eye - center) / 3.0).min() > 1.0 / 3.0 - 0.05
            centers.append(center)
        np.testing.assert_allclose(
            move(pair.T_target_source, centers[0][None])[0], centers[1], atol=0.02
        )


def test_what_is_recorded_can_be_computed_from_the_clouds(built: Path) -> None:
    pairs = MvpRgPairs(built, split="train")
    assert len(pairs) == 5
    for number, pair in enumerate(pairs):
        assert pair.source.shape == pair.target.shape == (150, 3)
        facts = pairs.facts(number)
        overlap = scan_overlap(move(pair.T_target_source, pair.source), pair.target)
        # Stored in single precision: a point at the limit may fall on its other side.
        assert facts["overlap"] == pytest.approx(overlap, abs=0.021)
        assert facts["overlap"] >= 0.3
        assert facts["match_level"] == int(facts["overlap"] >= 0.6)
        assert facts["rotation_level"] == 1
        match = ("low", "high")[facts["match_level"]]
        assert pairs.group(number) == f"match {match}, any rotation"
        R = pair.T_target_source[:3, :3]
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)


def test_a_sensor_may_look_instead_of_a_perfect_eye() -> None:
    noisy = replace(SMALL, sensor=Sensor(noise=0.005))
    (exact,), (other,) = (made(source_of("a", "b"), config, 1) for config in (SMALL, noisy))
    radii = [
        np.linalg.norm(points - fitted_center(points), axis=1)
        for points in (exact.source.astype(float), other.source.astype(float))
    ]
    assert radii[0].std() < 0.01 < radii[1].std() < 0.1


def test_the_released_mixture_turns_four_of_five_by_little() -> None:
    config = replace(SMALL, rotation="released", views=4, min_overlap=0.0, points=20, resolution=12)
    pairs = made(source_of("a", "b"), config, 200)
    level = np.array([pair.rotation_level for pair in pairs])
    R = np.array([pair.T_target_source[:3, :3] for pair in pairs])
    angle_deg = np.degrees(Rotation.from_matrix(R).magnitude())
    small = angle_deg[level == 0]
    assert 0.7 < len(small) / 200 < 0.9
    assert small.max() <= 45.0
    assert small.mean() == pytest.approx(22.5, abs=4.0)
    assert angle_deg[level == 1].mean() == pytest.approx(126.5, abs=20.0)
    # Each cloud is turned as a whole, too: the eyes are all around.
    eyes = np.array([pair.source_viewpoint for pair in pairs])
    assert np.abs(eyes.mean(axis=0)).max() < 0.7


def test_a_pair_depends_on_its_number_alone() -> None:
    few, many = (PairMaker(replace(SMALL, train=count, test=1), [SHAPES]) for count in (3, 40))
    for number in (2, 0):
        one, other = few(Task("train", number)), many(Task("train", number))
        assert pickle.dumps(one) == pickle.dumps(other)


def test_the_bytes_hang_neither_on_order_nor_on_processes(built: Path, tmp_path: Path) -> None:
    def backwards(work: PairMaker, tasks: Any, done: Any) -> None:
        work = pickle.loads(pickle.dumps(work))
        for number, task in reversed(list(enumerate(tasks))):
            done(number, work(task))

    build_mvp_rg([SHAPES], tmp_path / "set", SMALL, run=backwards)
    assert content(tmp_path / "set") == content(built)
    other = build_mvp_rg([SHAPES], tmp_path / "other", replace(SMALL, seed=4))
    shards = other["splits"]["test"]["shards"]
    assert shards[0]["sha256"] not in (built / "manifest.json").read_text()


def test_an_interrupted_build_goes_on_where_it_was(built: Path, tmp_path: Path) -> None:
    out, calls, told = tmp_path / "set", [], []

    def interrupted(work: PairMaker, tasks: Any, done: Any) -> None:
        for number, task in enumerate(tasks):
            if number == 3:
                raise KeyboardInterrupt
            done(number, work(task))

    def counted(work: PairMaker, tasks: Any, done: Any) -> None:
        tasks = list(tasks)
        calls.extend(tasks)
        one_after_the_other(work, tasks, done)

    with pytest.raises(KeyboardInterrupt):
        build_mvp_rg([SHAPES], out, SMALL, run=interrupted)
    assert set(content(out)) == {"building.json", "train-00000.npz"}
    with pytest.raises(ReadError, match="still being built"):
        open_pairs(out)
    with pytest.raises(InputError, match=r"config.seed: 3 there, 4 asked for"):
        build_mvp_rg([SHAPES], out, replace(SMALL, seed=4))
    # Half of a copied shard is not taken for a whole one.
    shutil.copy(built / "test-00000.npz", out / "train-00001.npz")
    (out / "train-00002.npz").write_bytes((built / "train-00002.npz").read_bytes()[:900])
    build_mvp_rg([SHAPES], out, SMALL, run=counted, advance=told.append)
    assert Counter(task.split for task in calls) == {"train": 3, "test": 3}
    assert sum(told) == 8
    assert content(out) == content(built)


def test_a_finished_set_is_made_once_and_mended(copied: Path, built: Path) -> None:
    def never(work: PairMaker, tasks: Any, done: Any) -> None:
        raise AssertionError("there is nothing left to do")

    build_mvp_rg([SHAPES], copied, SMALL, run=never)
    shard = dict(np.load(copied / "train-00001.npz"))
    np.savez(copied / "train-00001.npz", **{**shard, "source": shard["source"] + 1.0})
    pairs = MvpRgPairs(copied, split="train")
    pairs.pair(0)
    with pytest.raises(ReadError, match="changed or damaged"):
        pairs.pair(2)
    build_mvp_rg([SHAPES], copied, SMALL)
    assert content(copied) == content(built)


def test_a_full_disk_is_named_and_costs_nothing(
    built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, written = tmp_path / "set", []

    def fsync(descriptor: int) -> None:
        written.append(descriptor)
        if len(written) > 2:
            raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fsync)
        with pytest.raises(WriteError, match=rf"No space left.*stays in {out}"):
            build_mvp_rg([SHAPES], out, SMALL)
    assert set(content(out)) == {"building.json", "train-00000.npz"}
    build_mvp_rg([SHAPES], out, SMALL)
    assert content(out) == content(built)


def test_folders_of_others_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="expected an empty folder"):
        build_mvp_rg([SHAPES], tmp_path, SMALL)
    assert set(content(tmp_path)) == {"notes.txt"}


BAD = {
    "unreadable": ValueError("a damaged file"),
    "empty": mesh_of(np.zeros((0, 3)), np.zeros((0, 3), int)),
    "faceless": mesh_of(np.eye(3), np.zeros((0, 3), int)),
    "degenerate": mesh_of(np.eye(3), [[0, 0, 1], [1, 1, 1]]),
    "nan": mesh_of([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]]),
    "infinite": mesh_of([[0, 0, 0], [1, 0, 0], [0, np.inf, 0]], [[0, 1, 2]]),
    "huge": mesh_of([[0, 0, 0], [1e300, 0, 0], [0, 1e300, 0]], [[0, 1, 2]]),
    "outside": mesh_of(np.eye(3), [[0, 1, 7]]),
    "needle": mesh_of([[0, 0, 0], [1, 0, 0], [1, 1e-9, 0]], [[0, 1, 2]]),
}
UNREAD, NO_SURFACE = {"unreadable"}, set(BAD) - {"unreadable", "needle"}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_mesh_is_skipped_and_counted(name: str) -> None:
    source = Meshes(**{name: BAD[name], "good": sphere()})
    pairs = made(source, SMALL, 6)
    assert all(pair.name == "good" for pair in pairs)
    skips = [skip for pair in pairs for skip in pair.skips]
    assert {skip.shape for skip in skips} == {name}
    reasons = {skip.reason for skip in skips}
    if name in UNREAD:
        assert reasons == {mvp_pair.NOT_READ}
    elif name in NO_SURFACE:
        assert reasons == {mvp_pair.NO_SURFACE}
    else:
        assert reasons == {mvp_pair.EMPTY_VIEW, mvp_pair.APART}


def test_shapes_that_give_nothing_end_the_build(tmp_path: Path) -> None:
    bad = Meshes(nan=BAD["nan"], needle=BAD["needle"])
    with pytest.raises(InputError, match=r"none in 20 tries for pair 0 of train: .*little"):
        build_mvp_rg([bad], tmp_path / "set", SMALL, test_shapes=[source_of("good")])
    assert set(content(tmp_path / "set")) == {"building.json"}


def test_skips_stand_in_the_manifest(tmp_path: Path) -> None:
    shapes = Meshes(good=sphere(), nan=BAD["nan"])
    manifest = build_mvp_rg([shapes], tmp_path, SMALL, test_shapes=[source_of("other")])
    part = manifest["splits"]["train"]
    assert part["count"] == 5
    assert part["skips"][mvp_pair.NO_SURFACE] >= 2
    total = sum((Counter(shard["skips"]) for shard in part["shards"]), Counter())
    assert total == Counter(part["skips"])
    shard = json.loads(str(np.load(tmp_path / "train-00000.npz")["shard"]))
    assert [1, "nan", mvp_pair.NO_SURFACE] in shard["skips"]


def test_winding_holes_and_scale_do_not_matter() -> None:
    whole = sphere()
    half = mesh_of(whole.vertices, whole.faces[whole.triangles_center[:, 2] > 0.0])
    config = replace(SMALL, min_overlap=0.0)
    flipped = mesh_of(half.vertices, half.faces[:, ::-1])
    large = mesh_of(half.vertices * 4096.0, half.faces)
    pairs = [made(Meshes(half=mesh), config, 1)[0] for mesh in (half, flipped, large)]
    for other in pairs[1:]:
        np.testing.assert_allclose(other.source, pairs[0].source, atol=1e-5)
        assert other.overlap == pytest.approx(pairs[0].overlap, abs=0.02)


def test_a_flat_plate_is_seen_from_its_sides_only() -> None:
    plate = mesh_of([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    for pair in made(Meshes(plate=plate, other=plate), SMALL, 3):
        assert not isinstance(pair, FullturnError)
        flatness = np.linalg.svd(pair.source - pair.source.mean(axis=0), compute_uv=False)[-1]
        assert flatness < 1e-5


def test_training_and_test_shapes_have_no_name_in_common() -> None:
    parts = split_shapes([ProceduralShapes(200, seed=1)], [], SMALL)
    names = {split: {shape.name for shape in shapes} for split, shapes in parts.items()}
    assert names["train"] | names["test"] == {f"procedural_1_{i:05d}" for i in range(200)}
    assert not names["train"] & names["test"]
    assert len(names["test"]) == 40
    # The parts are those of the shapes and the seed, however many pairs are asked for.
    assert split_shapes([ProceduralShapes(200, seed=1)], [], replace(SMALL, train=0)) == parts
    other = split_shapes([ProceduralShapes(200, seed=1)], [], replace(SMALL, seed=4))
    assert {shape.name for shape in other["test"]} != names["test"]
    shares = Counter(shape.category for shape in parts["test"])
    for category, count in Counter(s.category for s in [*parts["train"], *parts["test"]]).items():
        assert abs(shares[category] - count / 5) <= 1.0
    with pytest.raises(InputError, match=r"1 names in both, b among them"):
        split_shapes([source_of("a", "b")], [source_of("b", "c")], SMALL)
    with pytest.raises(InputError, match="at least one shape to train and another one"):
        split_shapes([source_of("a")], [], SMALL)


def test_all_shapes_are_shown_and_no_category_rules() -> None:
    shapes = [Shape(0, i, f"s{i}", "many" if i < 100 else f"c{i}") for i in range(160)]
    chosen = schedule(shapes, 1600)
    assert {shape.category for shape in chosen[:61]} == {shape.category for shape in shapes}
    by_category = Counter(shape.category for shape in chosen)
    assert by_category["many"] == 200  # an eighth
    others = [by_category[f"c{i}"] for i in range(100, 160)]
    assert max(others) - min(others) <= 1
    assert set(Counter(s.name for s in chosen if s.category == "many").values()) == {2}
    assert schedule(shapes, 300) == chosen[:300]
    alone = schedule(shapes[:100], 250)
    assert set(Counter(shape.name for shape in alone).values()) == {2, 3}


def test_a_set_is_opened_by_its_folder(built: Path) -> None:
    pairs, train = open_pairs(built), open_pairs(f"{built}:train")
    assert isinstance(pairs, MvpRgPairs)
    assert (pairs.name, len(pairs)) == ("mvp-rg/built", 3)
    assert (train.name, len(train)) == ("mvp-rg/built-train", 5)
    assert train.pair(4).source_viewpoint is not None
    assert train.pair(4).source.tobytes() == train.pair(4).source.tobytes()
    told = json.dumps(pairs.description)
    assert str(built.parent) not in told
    assert pairs.description["shapes"][0]["kind"] == "procedural"
    with pytest.raises(InputError, match="from 0 to 2"):
        pairs.pair(3)
    with pytest.raises(InputError, match="expected a split out of train, test"):
        open_pairs(f"{built}:val")


def test_other_manifests_are_refused(copied: Path) -> None:
    manifest = json.loads((copied / "manifest.json").read_text())
    for change, message in (
        ({"format": 99}, "expected format 1, found 99"),
        ({"kind": "of another"}, "another kind of file"),
    ):
        (copied / "manifest.json").write_text(json.dumps({**manifest, **change}))
        with pytest.raises(ReadError, match=message):
            open_pairs(copied)
    (copied / "manifest.json").write_text("[]")
    with pytest.raises(ReadError, match="expected a JSON object"):
        open_pairs(copied)


def test_a_wrong_config_names_all_that_is_wrong() -> None:
    with pytest.raises(InputError, match=r"points 2 .*views 1 .*distance 1.0 .*min_overlap 2.0"):
        MvpRgConfig(points=2, views=1, distance=1.0, min_overlap=2.0)
    with pytest.raises(InputError, match="one of train and test more than 0"):
        MvpRgConfig(train=0, test=0)
