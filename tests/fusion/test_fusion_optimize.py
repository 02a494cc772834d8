"""The pose graph against SciPy, the joint refinement against known motions."""

from __future__ import annotations

import sys
from itertools import combinations

import numpy as np
import pytest
import torch
from fusion_cases import between, errors, jitter, random_pose, random_poses
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fullturn.errors import DependencyError
from fullturn.fusion.joint import _partners, refine_joint
from fullturn.fusion.optimize import _KERNEL, _LEAST_SIGMA, Link, gtsam, optimize_poses
from fullturn.geometry import rigid
from fullturn.geometry.neighbors import NeighborIndex
from fullturn.geometry.normals import estimate_normals


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gtsam", None)
    with pytest.raises(DependencyError, match=r"fullturn\[fuse\]"):
        gtsam()


def test_the_optimum_and_its_covariance_are_those_of_scipy() -> None:
    pytest.importorskip("gtsam")
    rng = np.random.default_rng(0)
    truth = random_poses(4, rng)
    truth = np.linalg.inv(truth[0]) @ truth
    links = []
    for i, j in combinations(range(4), 2):
        root = 1e-2 * rng.normal(size=(6, 6)) + 2e-2 * np.eye(6)
        T = jitter(between(truth, i, j), rng, deg=0.3, shift=0.005)
        links.append(Link(i, j, T, root @ root.T))

    def moved(x: np.ndarray) -> list[torch.Tensor]:
        steps = rigid.exp_se3(torch.from_numpy(x).view(-1, 6))
        return [torch.eye(4, dtype=torch.float64), *(torch.from_numpy(truth[1:]) @ steps)]

    def residuals(x: np.ndarray) -> np.ndarray:
        poses, rows = moved(x), []
        for link in links:
            said = torch.from_numpy(link.T_target_source)
            twist = rigid.log_se3(
                rigid.invert(said) @ rigid.invert(poses[link.target]) @ poses[link.source]
            )
            noise = link.covariance + _LEAST_SIGMA**2 * np.eye(6)
            rows.append(np.linalg.solve(np.linalg.cholesky(noise), twist.numpy()))
        return np.concatenate(rows)

    expected = least_squares(residuals, np.zeros(18), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    # None of them is far enough off for the robust kernel to matter.
    assert np.linalg.norm(expected.fun.reshape(-1, 6), axis=1).max() < _KERNEL
    poses, covariance = optimize_poses(truth, links)
    np.testing.assert_allclose(poses, torch.stack(moved(expected.x)).numpy(), atol=1e-4)
    inverse = np.linalg.inv(expected.jac.T @ expected.jac)
    for number in range(1, 4):
        block = inverse[6 * number - 6 : 6 * number, 6 * number - 6 : 6 * number]
        np.testing.assert_allclose(covariance[number], block, rtol=0.1, atol=3e-6)
    np.testing.assert_array_equal(covariance[0], 0.0)


def test_an_outlier_moves_little() -> None:
    pytest.importorskip("gtsam")
    rng = np.random.default_rng(1)
    truth = random_poses(6, rng)
    truth = np.linalg.inv(truth[0]) @ truth
    links = [
        Link(i, j, between(truth, i, j), 1e-4 * np.eye(6)) for i, j in combinations(range(6), 2)
    ]
    links[3] = Link(0, 4, jitter(between(truth, 0, 4), rng, deg=8, shift=0.1), 1e-4 * np.eye(6))
    start = np.stack([truth[0], *(jitter(T, rng, deg=3, shift=0.03) for T in truth[1:])])
    poses, _ = optimize_poses(start, links)
    for found, true in zip(poses, truth, strict=True):
        angle, shift = errors(found, true)
        assert angle < 1.0
        assert shift < 0.02


def _patches(rng: np.random.Generator, count: int = 6, points: int = 2500) -> list[torch.Tensor]:
    """Overlapping caps of a bumpy ball, each its own sampling."""
    caps = []
    for k in range(count):
        u = rng.normal(size=(9000, 3))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        turn = 2 * np.pi * k / count
        at = np.array([np.cos(turn), np.sin(turn), 0.2 * (-1) ** k])
        u = u[u @ at > 0.2][:points]
        bumps = 1 + 0.15 * np.sin(4 * u[:, :1]) + 0.1 * np.cos(5 * u[:, 1:2] + 1) * u[:, 2:]
        caps.append(torch.from_numpy(u * bumps))
    return caps


@pytest.mark.parametrize("offset", [0.0, 10.0])
def test_the_joint_refinement_closes_the_ring(offset: float) -> None:
    rng = np.random.default_rng(2)
    caps = _patches(rng)
    truth = np.stack([np.eye(4), *(random_pose(rng, shift=offset or 1.0) for _ in caps[1:])])
    clouds = [
        rigid.apply(rigid.invert(torch.from_numpy(T)), cap)
        for T, cap in zip(truth, caps, strict=True)
    ]
    normals = [estimate_normals(cloud, k=12, orientation="none") for cloud in clouds]
    start = np.stack(
        [truth[0], *(T @ jitter(np.eye(4), rng, deg=1.0, shift=0.01) for T in truth[1:])]
    )
    if offset:
        # A rotation about a far origin is a large shift: start in the middle of the scans.
        start[1:, :3, 3] = truth[1:, :3, 3]
        start[1:, :3, :3] = truth[1:, :3, :3]
    refined = refine_joint(torch.from_numpy(start), clouds, normals, reach=0.12, closest=0.05)
    for found, true in zip(refined.numpy(), truth, strict=True):
        angle, _ = errors(found, true)
        middle = found @ [*(np.linalg.inv(true)[:3, 3]), 1] - [0, 0, 0, 1]
        assert angle < 0.25
        assert np.linalg.norm(middle[:3]) < 0.01
    np.testing.assert_array_equal(refined[0].numpy(), start[0])


def test_of_many_scans_each_is_pulled_to_those_that_it_overlaps_most() -> None:
    rng = np.random.default_rng(4)
    caps = _patches(rng, count=20, points=600)
    normals = [estimate_normals(cap, k=12, orientation="none") for cap in caps]
    start = torch.from_numpy(np.stack([jitter(np.eye(4), rng, deg=1.0, shift=0.01) for _ in caps]))
    start[0] = torch.eye(4)
    pairs = _partners(start, caps, [NeighborIndex(cap) for cap in caps], 0.15, [1] * 20)
    assert [sum(i == one for i, _ in pairs) for one in range(20)] == [15] * 20
    assert not {(0, 9), (0, 10), (0, 11)} & {*pairs}  # the far side
    refined = refine_joint(start, caps, normals, reach=0.15, closest=0.08)
    angle = rigid.rotation_angle_rad(refined[:, :3, :3]).rad2deg()
    assert float(angle.max()) < 0.5


def test_scans_that_lie_apart_stay_where_they_are() -> None:
    rng = np.random.default_rng(0)
    cloud = torch.from_numpy(rng.normal(size=(100, 3)))
    start = torch.eye(4, dtype=torch.float64).repeat(2, 1, 1)
    start[1, 0, 3] = 100.0
    normals = torch.nn.functional.normalize(cloud, dim=-1)
    refined = refine_joint(start, [cloud] * 2, [normals] * 2, reach=0.1, closest=0.05)
    torch.testing.assert_close(refined, start)


def test_a_ring_with_drift_is_refined_until_it_rests() -> None:
    """Twelve sectors of a faintly rippled ball, each turned a little farther than the last."""
    rng = np.random.default_rng(3)
    count, clouds, start = 12, [], []
    for k in range(count):
        azimuth = 2 * np.pi / count * (k + rng.uniform(-0.8, 0.8, 2500))
        z = rng.uniform(-0.7, 0.7, 2500)
        ring = np.sqrt(1 - z**2)
        u = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], 1)
        ripple = 1 + 0.02 * np.sin(5 * azimuth + 3 * z) + 0.05 * z * np.cos(azimuth)
        clouds.append(torch.from_numpy(u * ripple[:, None]))
        turn = Rotation.from_rotvec([0.0, 0.0, np.radians(0.3 * k)]).as_matrix()
        start.append(rigid.make(torch.from_numpy(turn), torch.zeros(3).double()))
    normals = [estimate_normals(cloud, k=12, orientation="none") for cloud in clouds]
    refined = refine_joint(torch.stack(start), clouds, normals, reach=0.12, closest=0.05)
    angle = rigid.rotation_angle_rad(refined[:, :3, :3]).rad2deg()
    assert float(angle.max()) < 0.4
