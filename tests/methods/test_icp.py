"""ICP finds a nearby pose as exactly as the data allow, on every scale of detail."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from fullturn.geometry.cloud import Cloud
from fullturn.methods.classical.icp import IcpPlane, IcpPoint


def surface(count: int, rng: np.random.Generator) -> np.ndarray:
    """A bumpy, stretched ball without symmetry."""
    u = rng.normal(size=(count, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    height = 1 + 0.3 * np.sin(3 * u[:, :1] + 1) + 0.2 * u[:, 1:2] * u[:, 2:]
    return u * height * (1.0, 0.8, 0.6)


def cloud(points: np.ndarray) -> Cloud:
    return Cloud(torch.from_numpy(points - points.mean(axis=0)))


def error_deg(T: torch.Tensor, R: np.ndarray) -> float:
    return float(np.degrees(Rotation.from_matrix(R.T @ T[:3, :3].numpy()).magnitude()))


@pytest.mark.parametrize("method", [IcpPoint, IcpPlane])
@pytest.mark.parametrize("angle_deg", [0.0, 5.0, 25.0])
def test_the_same_points_are_aligned_exactly(
    method: type[IcpPoint | IcpPlane], angle_deg: float
) -> None:
    rng = np.random.default_rng(0)
    points = surface(600, rng)
    R = Rotation.from_rotvec(np.radians([0, 0.6 * angle_deg, 0.8 * angle_deg])).as_matrix()
    estimate = method().estimate(cloud(points), cloud(points @ R.T), rng=rng)
    assert error_deg(estimate.T_target_source[0], R) < 1e-6
    assert estimate.success_probability is None


@pytest.mark.parametrize(("method", "limit_deg"), [(IcpPoint, 1.5), (IcpPlane, 1.0)])
def test_partial_views_of_other_samples(
    method: type[IcpPoint | IcpPlane], limit_deg: float
) -> None:
    rng = np.random.default_rng(1)
    source, target = surface(2000, rng), surface(2000, rng)
    source, target = source[source[:, 0] > -0.6], target[target[:, 0] < 0.6]
    R = Rotation.from_rotvec([0.1, -0.15, 0.2]).as_matrix()
    estimate = method().estimate(cloud(source), cloud(target @ R.T), rng=rng)
    assert error_deg(estimate.T_target_source[0], R) < limit_deg


@pytest.mark.parametrize("method", [IcpPoint, IcpPlane])
@pytest.mark.parametrize("shape", ["plane", "four points", "copies"])
def test_degenerate_clouds_give_a_rigid_answer(
    method: type[IcpPoint | IcpPlane], shape: str
) -> None:
    rng = np.random.default_rng(2)
    points = {
        "plane": rng.normal(size=(100, 3)) * (1.0, 1.0, 0.0),
        "four points": rng.normal(size=(4, 3)),
        "copies": np.repeat(rng.normal(size=(5, 3)), 20, axis=0),
    }[shape]
    T = method().estimate(cloud(points), cloud(points), rng=rng).T_target_source[0].numpy()
    np.testing.assert_allclose(T, np.eye(4), atol=1e-6)


def test_agrees_with_small_gicp() -> None:
    small_gicp = pytest.importorskip("small_gicp")
    rng = np.random.default_rng(3)
    source, target = surface(3000, rng), surface(3000, rng)
    R = Rotation.from_rotvec([0.05, -0.05, 0.1]).as_matrix()
    source_cloud, target_cloud = cloud(source), cloud(target @ R.T)
    ours = IcpPlane().estimate(source_cloud, target_cloud, rng=rng).T_target_source[0].numpy()
    theirs = small_gicp.align(
        target_cloud.points.numpy(),
        source_cloud.points.numpy(),
        registration_type="PLANE_ICP",
        downsampling_resolution=0.02,
        max_correspondence_distance=0.3,
        num_threads=1,
    ).T_target_source
    apart = np.linalg.inv(ours) @ theirs
    assert np.degrees(Rotation.from_matrix(apart[:3, :3]).magnitude()) < 0.5
    assert np.linalg.norm(apart[:3, 3]) < 0.01
