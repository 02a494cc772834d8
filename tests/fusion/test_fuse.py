"""Fusing from the front: inputs, cache, groups, units; registration is exact, or a stub."""

from __future__ import annotations

import base64
import json
from dataclasses import asdict
from itertools import product
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from fusion_cases import errors, jitter, random_pose
from scipy.spatial import cKDTree

import fullturn
from fullturn.errors import InputError
from fullturn.fusion import edges as edges_module
from fullturn.fusion.edges import pair_key
from fullturn.fusion.likely import PAIRS_PER_SCAN, likely_pairs, next_pairs
from fullturn.fusion.report import render_fusion_report
from fullturn.fusion.scans import check_scans
from fullturn.io import save_cloud
from fullturn.pose.kabsch import weighted_kabsch
from fullturn.result import Alternative, Registration

pytest.importorskip("gtsam")


def shape(which: int = 0, count: int = 1500) -> np.ndarray:
    """A bumpy ball: no turn maps it onto itself."""
    u = np.random.default_rng(which).normal(size=(count, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    x, y, z = u.T
    bumps = 1 + 0.3 * np.sin(3 * x + which) + 0.2 * y * z + 0.25 * np.cos(4 * y - which) * x
    return u * bumps[:, None] * (1.0, 0.8, 0.6)


def fit(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, bool]:
    """The pose of a cloud on another of the same shape, and whether they are of one shape at all.

    The same rows are the same points, but in a group's cloud, which is known by its axes.
    """
    n = min(len(source), len(target))
    T = pose_of_rows(source[:n], target[:n])
    if np.abs(source[:n] @ T[:3, :3].T + T[:3, 3] - target[:n]).max() < 1e-6:
        return T, True
    tree = cKDTree(target)
    reach = np.median(tree.query(target, k=2)[0][:, 1])
    starts = []
    for first, second in product((-1.0, 1.0), repeat=2):
        turn = axes(target) @ np.diag([first, second, first * second]) @ axes(source).T
        moved = (source - source.mean(axis=0)) @ turn.T + target.mean(axis=0)
        for _ in range(20):
            T = pose_of_rows(source, target[tree.query(moved)[1]])
            moved = source @ T[:3, :3].T + T[:3, 3]
        starts.append((float(np.median(tree.query(moved)[0])), T))
    apart, T = min(starts, key=itemgetter(0))
    return T, apart < reach


def pose_of_rows(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    one, other = torch.from_numpy(source), torch.from_numpy(target)
    return weighted_kabsch(one, other, torch.ones_like(one[:, 0])).numpy()


def axes(cloud: np.ndarray) -> np.ndarray:
    """The principal axes of a cloud, as columns of a rotation."""
    found = np.linalg.svd(cloud - cloud.mean(axis=0), full_matrices=False)[2].T
    return found * np.sign(np.linalg.det(found))


class Exact:
    """A registration that knows the pose of a shape, and doubts what is another shape."""

    def __init__(self) -> None:
        self.calls = 0
        self.wrong: set[int] = set()  # calls that are answered wrongly and surely
        self.told: list[tuple[np.ndarray, np.ndarray]] = []  # viewpoints, and their clouds

    def __call__(
        self, source: Any, target: Any, *, method: str, seed: int, **viewpoints: np.ndarray
    ) -> Registration:
        rng = np.random.default_rng(self.calls)
        self.calls += 1
        a, b = source.points, target.points
        for role, cloud in (("source", a), ("target", b)):
            if f"{role}_viewpoint" in viewpoints:
                self.told.append((viewpoints[f"{role}_viewpoint"], cloud))
        T, fits = fit(a, b)
        if fits and self.calls - 1 in self.wrong:
            T = random_pose(rng, shift=0.1)
        others = [Alternative(random_pose(rng, shift=0.1), 0.02, (0.3, 0.3))]
        return Registration(
            T_target_source=T if fits else random_pose(rng, shift=0.1),
            success_probability=0.95 if fits else 0.1,
            overlap=(0.9, 0.9) if fits else (0.4, 0.4),
            alternatives=tuple(others),
            symmetry=None,
            matches=np.zeros((0, 2), dtype=np.int64),
            match_weights=np.zeros(0),
            covariance=1e-4 * np.eye(6),
            seconds={"total": 0.0},
            method=method,
        )


@pytest.fixture
def exact(monkeypatch: pytest.MonkeyPatch) -> Exact:
    stub = Exact()
    monkeypatch.setattr(edges_module, "register", stub)
    return stub


def scans_of(
    cloud: np.ndarray, count: int, *, scale: float = 1.0, far: float = 0.0, seed: int = 0
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Moved copies, each without some last rows, and T_scan_object of each."""
    rng = np.random.default_rng(seed)
    poses = [random_pose(rng, shift=scale) for _ in range(count)]
    for T in poses:
        T[:3, 3] += far
    kept = [cloud[: len(cloud) - 10 * k] * scale for k in range(count)]
    return [c @ T[:3, :3].T + T[:3, 3] for c, T in zip(kept, poses, strict=True)], poses


@pytest.mark.parametrize(("scale", "far"), [(1.0, 0.0), (1e-3, 0.0), (1e3, 0.0), (1.0, 1e6)])
def test_poses_in_any_unit_and_anywhere(exact: Exact, scale: float, far: float) -> None:
    clouds, poses = scans_of(shape(), 5, scale=scale, far=far)
    before = [cloud.copy() for cloud in clouds]
    fusion = fullturn.fuse(clouds)
    assert fusion.groups == ((0, 1, 2, 3, 4),)
    for number, T in enumerate(fusion.T_world_scan):
        true = poses[0] @ np.linalg.inv(poses[number])
        assert T is not None
        angle, _ = errors(T, true)
        assert angle < 0.02
        middle = clouds[number].mean(0)
        moved = (T[:3, :3] - true[:3, :3]) @ middle + T[:3, 3] - true[:3, 3]
        assert np.linalg.norm(moved) < 1e-3 * scale
        assert fusion.covariance[number] is not None
    assert min(fusion.probability) > 0.9
    # One surface, not five: no more points than one scan has, and all of them counted.
    assert len(fusion.points) <= len(clouds[0])
    assert fusion.merged[0].count.sum() == sum(map(len, clouds))
    for cloud, kept in zip(clouds, before, strict=True):
        np.testing.assert_array_equal(cloud, kept)


def test_two_objects_are_two_groups_each_in_its_own_frame(exact: Exact) -> None:
    ones, poses = scans_of(shape(0), 4)
    others, other_poses = scans_of(shape(5), 3, seed=1)
    fusion = fullturn.fuse([others[0], *ones, *others[1:]])
    assert fusion.groups == ((1, 2, 3, 4), (0, 5, 6))
    assert fusion.group == (1, 0, 0, 0, 0, 1, 1)
    for first, numbers, true in ((1, (1, 2, 3, 4), poses), (0, (0, 5, 6), other_poses)):
        np.testing.assert_allclose(fusion.T_world_scan[first], np.eye(4), atol=1e-9)
        for place, number in enumerate(numbers):
            T = fusion.T_world_scan[number]
            assert T is not None
            assert errors(T, true[0] @ np.linalg.inv(true[place]))[0] < 0.02
    assert any("2 groups" in note for note in fusion.notes)
    assert len(fusion.merged) == 2
    # Both groups were tried as whole clouds, once.
    whole = [edge for edge in fusion.edges if len(edge.target_scans) > 1]
    assert [(edge.target_scans, edge.source_scans) for edge in whole] == [fusion.groups]
    assert all(edge.chosen == -1 for edge in whole)
    page = render_fusion_report([others[0], *ones, *others[1:]], fusion)
    assert " and 3 more" in page


def test_viewpoints_come_along_in_the_unit_and_frame_of_the_pair(exact: Exact) -> None:
    clouds, _ = scans_of(shape(), 3, scale=1e3, far=1e5)
    fullturn.fuse(clouds, viewpoints=[clouds[0][7], None, list(clouds[2][7])])
    assert len(exact.told) == 4  # each of two scans is in two pairs
    for place, cloud in exact.told:
        np.testing.assert_allclose(place, cloud[7], atol=1e-9)


def test_another_viewpoint_is_another_pair_in_the_cache(exact: Exact, tmp_path: Path) -> None:
    clouds, _ = scans_of(shape(), 3)
    fullturn.fuse(clouds, cache=tmp_path)
    fullturn.fuse(clouds, cache=tmp_path, viewpoints=[None, None, (0.0, 0.0, 5.0)])
    assert exact.calls == 5  # two of three pairs again


@pytest.mark.parametrize(
    ("viewpoints", "message"),
    [
        ([None], "one per scan, 2, got 1"),
        ([None, (0.0, 1.0)], "scan 2: expected three finite numbers"),
        ([None, (0.0, 1.0, float("inf"))], "scan 2: expected three finite numbers"),
        ([None, "here"], "scan 2: expected three numbers, got 'here'"),
        ("here", "a list"),
        (3, "a list"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_viewpoints_that_are_none_are_an_error(viewpoints: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        fullturn.fuse([shape(), shape(1)], viewpoints=viewpoints)


def test_a_wrong_sure_answer_is_outvoted(exact: Exact) -> None:
    exact.wrong = {2}
    clouds, _ = scans_of(shape(), 5)
    fusion = fullturn.fuse(clouds)
    assert fusion.groups == ((0, 1, 2, 3, 4),)
    assert [number for number, edge in enumerate(fusion.edges) if edge.chosen < 0] == [2]


def test_what_cannot_be_used_is_named_and_left_out(exact: Exact, tmp_path: Path) -> None:
    clouds, _ = scans_of(shape(), 3)
    files = []
    for number, cloud in enumerate(clouds):
        save_cloud(tmp_path / f"scan{number}.ply", cloud)
        files.append(tmp_path / f"scan{number}.ply")
    (tmp_path / "empty.ply").write_bytes(b"")
    save_cloud(tmp_path / "copy.npy", clouds[1])
    fusion = fullturn.fuse([files[0], tmp_path / "empty.ply", files[1], tmp_path / "copy.npy"])
    assert fusion.group == (0, -1, 0, -1)
    assert fusion.T_world_scan[1] is None
    assert any("empty.ply" in note for note in fusion.notes)
    assert any("copy.npy: it holds the same points as scan1.ply" in n for n in fusion.notes)
    assert fusion.names == ("scan0.ply", "empty.ply", "scan1.ply", "copy.npy")


@pytest.mark.parametrize("clouds", [[], [shape()], [shape(), shape()], "scan.ply", None])
@pytest.mark.usefixtures("unchecked")
def test_fewer_than_two_scans_are_an_error(clouds: Any) -> None:
    with pytest.raises(InputError, match="at least 2"):
        fullturn.fuse(clouds)


@pytest.mark.parametrize("value", [0.0, 1.5, float("nan"), None, "a"])
def test_a_probability_out_of_range_is_an_error(value: Any) -> None:
    with pytest.raises(InputError, match="min_probability"):
        fullturn.fuse([shape(), shape(1)], min_probability=value)


def test_other_units_and_densities_are_said() -> None:
    _, notes = check_scans([shape(k) for k in range(3)] + [1000 * shape(3)])
    assert any("is its unit another" in note for note in notes)
    _, notes = check_scans([shape(k, 3000) for k in range(3)] + [shape(3, 12)])
    assert any("point spacing" in note for note in notes)


def test_a_scan_in_another_unit_stops_nothing(exact: Exact) -> None:
    clouds, _ = scans_of(shape(), 3)
    fusion = fullturn.fuse([*clouds, 1e-3 * shape(3), 1e3 * shape(4)])
    assert fusion.groups[0] == (0, 1, 2)


def test_copies_of_one_point_do_not_shrink_a_scan() -> None:
    cloud = shape(count=300)
    copies = np.repeat(cloud[:1], 40_000, axis=0)
    (scan, crowded), _ = check_scans([cloud, np.concatenate([cloud, copies])])
    assert crowded.radius == pytest.approx(scan.radius, rel=0.01)


def test_a_stopped_fusion_goes_on_from_the_cache(exact: Exact, tmp_path: Path) -> None:
    clouds, _ = scans_of(shape(), 4)
    first = fullturn.fuse(clouds, cache=tmp_path)
    assert exact.calls == 6 + 4  # all pairs, and each scan against the rest
    again = fullturn.fuse(clouds, cache=tmp_path)
    assert exact.calls == 10
    for one, other in zip(first.T_world_scan, again.T_world_scan, strict=True):
        np.testing.assert_array_equal(one, other)
    # A line that was cut off, as a killed run leaves it, costs that pair alone.
    file = tmp_path / "edges.jsonl"
    file.write_text(file.read_text()[:-50])
    fullturn.fuse(clouds, cache=tmp_path)
    assert exact.calls == 11
    # Nothing of it is taken for other scans, or another seed; that is said.
    other = fullturn.fuse(clouds, cache=tmp_path, seed=1)
    assert exact.calls == 21
    assert any("10 pairs of other scans, settings" in note for note in other.notes)


def test_one_scan_more_costs_its_own_pairs_alone(exact: Exact, tmp_path: Path) -> None:
    clouds, _ = scans_of(shape(), 4)
    fullturn.fuse(clouds[1:], cache=tmp_path)
    assert exact.calls == 3
    # Another size of the whole, too: the unit of the fusion is the scans' median radius.
    more = [*clouds, 3.0 * shape(1), 3.0 * shape(2)]
    alone = fullturn.fuse(more)
    calls, exact.calls = exact.calls - 3, 0
    larger = fullturn.fuse(more, cache=tmp_path)
    assert exact.calls == calls - 3
    assert not any("cache" in note for note in larger.notes)
    for kept, new in zip(larger.T_world_scan, alone.T_world_scan, strict=True):
        np.testing.assert_array_equal(kept, new)


@pytest.mark.parametrize("name", ["verdict.safetensors", "api.py", "whole.py"])
def test_a_refit_verdict_finds_nothing_in_the_cache(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scans, _ = check_scans([shape(), shape(1)])
    before = pair_key("icp-point", 0)(*scans)
    assert pair_key("icp-point", 0)(*scans) == before
    honest = Path.read_bytes
    monkeypatch.setattr(
        Path, "read_bytes", lambda path: b"refit" if path.name == name else honest(path)
    )
    assert pair_key("icp-point", 0)(*scans) != before


def test_a_foreign_cache_is_refused(tmp_path: Path) -> None:
    (tmp_path / "edges.jsonl").write_text("something\n")
    with pytest.raises(InputError, match="its first line says otherwise"):
        fullturn.fuse([shape(), shape(1)], cache=tmp_path)
    assert (tmp_path / "edges.jsonl").read_text() == "something\n"


def test_many_scans_register_the_likely_pairs_only(exact: Exact) -> None:
    clouds, _ = scans_of(shape(), 15)
    fusion = fullturn.fuse(clouds)
    assert fusion.groups == (tuple(range(15)),)
    assert len(fusion.edges) < 15 * 14 / 2


def test_likely_pairs_put_the_same_object_first() -> None:
    scans, _ = check_scans(scans_of(shape(0), 3)[0] + scans_of(shape(5), 3, seed=2)[0])
    order = likely_pairs(scans, 1.0)
    assert len(order) == 15
    assert {frozenset(pair) for pair in order[:6]} == {
        frozenset(pair) for pair in [(0, 1), (0, 2), (1, 2), (3, 4), (3, 5), (4, 5)]
    }


def test_rounds_end_within_their_budget() -> None:
    count = 20
    order = [(i, j) for i in range(count) for j in range(i + 1, count)]
    done: set[tuple[int, int]] = set()
    for _ in range(100):
        # Nothing ever connects.
        todo = next_pairs(order, done, [(scan,) for scan in range(count)], [], scans=count)
        if not todo:
            break
        assert not done & set(todo)
        done |= set(todo)
    assert len(done) == min(len(order), PAIRS_PER_SCAN * count)
    # Everything connected, each scan by two edges: done.
    ring = [(k, (k + 1) % count) for k in range(count)]
    assert next_pairs(order, {(0, 1)}, [tuple(range(count))], ring, scans=count) == []


def test_the_report_shows_every_scan_and_pair(exact: Exact) -> None:
    clouds, _ = scans_of(shape(), 3)
    everything = [*clouds, [[0, 0, 0]], shape(5)]
    fusion = fullturn.fuse(everything)
    page = render_fusion_report(everything, fusion)
    assert page == render_fusion_report(everything, fusion)
    assert page.count('type="checkbox"') == 5
    assert page.count("<circle") == 4
    assert page.count("<line") == 3
    assert "left out" in page
    assert "http" not in page.replace("http-equiv", "")
    data = page.split('id="scene">')[1].split("</script>")[0]
    assert len(json.loads(data)["scans"]) == 5


def test_stray_points_are_not_drawn_in_the_report(exact: Exact) -> None:
    clouds, _ = scans_of(shape(), 3)
    stray = np.vstack([clouds[0], clouds[0].mean(0) + 1e6])
    sizes = []
    for first in (clouds[0], stray):
        page = render_fusion_report([first, *clouds[1:]], fullturn.fuse([first, *clouds[1:]]))
        data = json.loads(page.split('id="scene">')[1].split("</script>")[0])
        drawn = data["scans"][1]
        steps = np.frombuffer(base64.b64decode(drawn["int16"]), "<i2").reshape(-1, 3)
        sizes.append(np.ptp(steps, axis=0) * drawn["step"])
    np.testing.assert_allclose(sizes[1], sizes[0], rtol=0.01)


def test_workers_change_nothing() -> None:
    rng = np.random.default_rng(0)
    moves = [jitter(np.eye(4), rng, deg=5.0, shift=0.1) for _ in range(3)]  # ICP undoes them
    clouds = [shape(count=600) @ T[:3, :3].T + T[:3, 3] for T in moves]
    one, two = (fullturn.fuse(clouds, method="icp-point", workers=w) for w in (1, 2))
    assert one.groups == ((0, 1, 2),)
    for name in ("T_world_scan", "covariance", "probability"):
        for a, b in zip(getattr(one, name), getattr(two, name), strict=True):
            np.testing.assert_array_equal(a, b, err_msg=name)
    for name in ("names", "group", "groups", "method", "notes"):
        assert getattr(one, name) == getattr(two, name), name
    assert [asdict(edge) for edge in one.edges] == [asdict(edge) for edge in two.edges]
    for cloud, other in zip(one.merged, two.merged, strict=True):
        np.testing.assert_array_equal(cloud.points, other.points)
        np.testing.assert_array_equal(cloud.count, other.count)


def test_virtual_scans_come_together_end_to_end() -> None:
    from fullturn.data.procedural import dog
    from fullturn.data.views import view_mesh

    rng = np.random.default_rng(0)
    views = list(view_mesh(dog(), views=9, points=1200, rng=rng))
    clouds = [view.points_camera for view in views]
    fusion = fullturn.fuse(clouds)
    group = fusion.groups[0]
    assert len(group) >= 6
    for number in group:
        T = fusion.T_world_scan[number]
        assert T is not None
        # The same points in the object's frame and in the camera's give the true pose.
        T_object = [
            pose_of_rows(views[k].points_camera, views[k].points_object) for k in (group[0], number)
        ]
        angle, shift = errors(T, np.linalg.inv(T_object[0]) @ T_object[1])
        assert angle < 2.0
        assert shift < 0.1
