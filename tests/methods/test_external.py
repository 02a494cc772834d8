"""The baselines: each solves what its authors say it solves, alike each time, large or tiny."""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from fullturn.data.procedural import demo_object
from fullturn.data.surface import sample_surface
from fullturn.errors import DependencyError
from fullturn.geometry.cloud import Cloud
from fullturn.methods.external.align import align, thinned
from fullturn.methods.external.rotation import rigid_or
from fullturn.methods.registry import get, methods, names

PACKAGE = {"ransac": "open3d", "ransac-4m": "open3d", "fgr": "open3d", "kiss": "kiss_matcher"}
GLOBAL = ["ransac", "fgr", "kiss"]


def made(name: str) -> Any:
    """An instance of the method; the test is skipped where its package is missing."""
    if name in PACKAGE:
        pytest.importorskip(PACKAGE[name], exc_type=ImportError)
    return get(name)()


def cloud(points: np.ndarray) -> Cloud:
    return Cloud(torch.from_numpy(points - points.mean(axis=0)))


def teapot(count: int, seed: int) -> np.ndarray:
    points = sample_surface(demo_object(), count, np.random.default_rng(seed))
    return points / np.linalg.norm(points, axis=1).max()


def solve(method: Any, source: np.ndarray, target: np.ndarray, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    estimate = method.estimate(cloud(source), cloud(target), rng=rng)
    assert estimate.success_probability is None
    (T,) = estimate.T_target_source.numpy()
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    return T


def angle_deg(T: np.ndarray, R: np.ndarray) -> float:
    return float(np.degrees(Rotation.from_matrix(R.T @ T[:3, :3]).magnitude()))


@pytest.mark.parametrize("name", GLOBAL)
@pytest.mark.parametrize("count", [800, 9000])
def test_any_turn_of_the_same_object_is_found(name: str, count: int) -> None:
    method = made(name)
    R = Rotation.from_rotvec([2.0, -1.5, 1.0]).as_matrix()
    source = teapot(count, 0)
    # Small clouds share their points, large ones the surface alone.
    target = (source if count < 1000 else teapot(count, 1))[::-1] @ R.T
    assert angle_deg(solve(method, source, target), R) < 2.0


@pytest.mark.parametrize("name", ["gicp", *GLOBAL, "ransac-4m"])
def test_the_same_seed_gives_the_same_bytes(name: str) -> None:
    method = made(name)
    source, target = teapot(700, 2), teapot(700, 3)[::-1]
    poses = {solve(method, source, target, seed=4).tobytes() for _ in range(3)}
    assert len(poses) == 1
    assert solve(get(name)(), source, target, seed=4).tobytes() in poses


@pytest.mark.parametrize("name", ["gicp", *GLOBAL])
def test_far_and_few_points_give_a_rigid_answer(name: str) -> None:
    method = made(name)
    rng = np.random.default_rng(5)
    for points in (
        np.eye(3),
        rng.normal(size=(4, 3)) * 9,
        rng.normal(size=(30, 3)) * 5,
        np.repeat(np.eye(3), 20, axis=0),
        rng.normal(size=(60, 3)) * (1, 1, 0),
    ):
        solve(method, points, points)


def test_gicp_finds_a_small_turn() -> None:
    R = Rotation.from_rotvec([0.1, -0.15, 0.2]).as_matrix()
    source, target = teapot(3000, 6), teapot(3000, 7) @ R.T
    assert angle_deg(solve(made("gicp"), source, target), R) < 0.5


def test_open3d_keeps_the_threads_of_its_user() -> None:
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    before = open3d.utility.get_max_threads()
    open3d.utility.set_max_threads(2)
    try:
        solve(made("fgr"), teapot(300, 8), teapot(300, 8))
        assert open3d.utility.get_max_threads() == 2
    finally:
        open3d.utility.set_max_threads(before)


def test_ours_and_open3ds_icp_agree() -> None:
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    source = teapot(2000, 9)
    R = Rotation.from_rotvec([0.02, 0.03, -0.02]).as_matrix()
    target = teapot(2000, 10) @ R.T
    ours = align(source, target, np.eye(4), kind="PLANE_ICP", distance=0.1, rounds=50, neighbors=30)
    clouds = [
        open3d.geometry.PointCloud(open3d.utility.Vector3dVector(x)) for x in (source, target)
    ]
    clouds[1].estimate_normals(open3d.geometry.KDTreeSearchParamKNN(30))
    registration = open3d.pipelines.registration
    theirs = registration.registration_icp(
        *clouds,
        0.1,
        np.eye(4),
        registration.TransformationEstimationPointToPlane(),
        registration.ICPConvergenceCriteria(max_iteration=50),
    ).transformation
    assert angle_deg(ours, np.array(theirs)[:3, :3]) < 0.5
    assert angle_deg(ours, R) < 0.5


@pytest.mark.parametrize("name", list(PACKAGE))
def test_a_missing_package_is_named(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, PACKAGE[name], None)
    with pytest.raises(DependencyError, match=PACKAGE[name]) as caught:
        get(name)()
    assert 'pip install "fullturn[baselines]"' in str(caught.value)
    assert ("libusb-1.0-0" in str(caught.value)) is (PACKAGE[name] == "open3d")


def test_what_each_method_needs_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fullturn.methods.registry.util.find_spec", lambda _: None)
    missing = {info.name: info.missing for info in methods()}
    assert missing == {name: (PACKAGE[name],) if name in PACKAGE else () for name in names()}


@pytest.mark.parametrize("name", names())
def test_settings_are_json(name: str) -> None:
    settings = get(name).settings()
    assert settings
    assert json.loads(json.dumps(settings)) == settings


def test_the_two_ransacs_differ_in_their_rounds_alone() -> None:
    few, many = (get(name).settings() for name in ("ransac", "ransac-4m"))
    assert few["ransac"].pop("rounds") == 100_000
    assert many["ransac"].pop("rounds") == 4_000_000
    assert few == many


def test_thinning_leaves_small_clouds_alone() -> None:
    points = teapot(500, 11)
    assert thinned(points, most_points=500, voxel=0.1) is points
    few = thinned(points, most_points=499, voxel=0.5)
    assert 3 < len(few) < 60


def test_rigid_or_repairs_rounding_and_refuses_nan() -> None:
    R = Rotation.from_rotvec([1.0, 2.0, -0.5]).as_matrix()
    T, other = np.eye(4), np.eye(4)
    T[:3, :3] = R.astype(np.float32)
    other[:3, 3] = 5.0
    repaired = rigid_or(T, other)
    np.testing.assert_allclose(repaired[:3, :3], R, atol=1e-6)
    np.testing.assert_allclose(repaired[:3, :3] @ repaired[:3, :3].T, np.eye(3), atol=1e-15)
    lost = np.full((4, 4), np.nan)
    np.testing.assert_array_equal(rigid_or(lost, other), other)
    np.testing.assert_array_equal(rigid_or(lost, lost), np.eye(4))
    mirror = np.diag([1.0, 1.0, -1.0, 1.0])
    assert np.linalg.det(rigid_or(mirror, other)[:3, :3]) == pytest.approx(1.0)
