"""Kabsch agrees with SciPy, always gives a rotation, and its gradients are finite everywhere."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from fullturn.pose.kabsch import nearest_rotation, weighted_kabsch


def motion(angle_deg: float, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    axis = rng.normal(size=3)
    R = Rotation.from_rotvec(np.radians(angle_deg) * axis / np.linalg.norm(axis)).as_matrix()
    return torch.from_numpy(R), torch.from_numpy(rng.normal(size=3))


def assert_rigid(T: Tensor, atol: float) -> None:
    R = T[..., :3, :3]
    torch.testing.assert_close(R @ R.mT, torch.eye(3).to(R).expand_as(R), atol=atol, rtol=0)
    torch.testing.assert_close(
        torch.linalg.det(R), torch.ones(R.shape[:-2]).to(R), atol=atol, rtol=0
    )
    torch.testing.assert_close(
        T[..., 3, :], torch.tensor([0.0, 0, 0, 1]).to(T).expand_as(T[..., 3, :])
    )


@pytest.mark.parametrize("angle_deg", [0.0, 1e-6, 30.0, 120.0, 179.9999, 180.0])
@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (1e-3, 0.0), (1e3, 0.0), (1.0, 1e6)])
def test_the_motion_is_recovered(angle_deg: float, scale: float, offset: float) -> None:
    rng = np.random.default_rng(1)
    R, t = motion(angle_deg, rng)
    source = torch.from_numpy(rng.normal(size=(40, 3))) * scale + offset
    target = source @ R.mT + t * scale
    T = weighted_kabsch(source, target, torch.from_numpy(rng.uniform(0.1, 1.0, 40)))
    precision = 1e-12 * max(1.0, offset)
    torch.testing.assert_close(T[:3, :3], R, atol=precision, rtol=0)
    moved = source @ T[:3, :3].mT + T[:3, 3]
    torch.testing.assert_close(moved, target, atol=100 * precision * scale, rtol=1e-12)


@pytest.mark.parametrize("points", [4, 50])
def test_agrees_with_scipy_on_noisy_pairs(points: int) -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        source, target = rng.normal(size=(2, points, 3))
        weights = rng.uniform(0.0, 2.0, points)
        T = weighted_kabsch(*map(torch.from_numpy, (source, target, weights)))
        source_mean, target_mean = (
            np.average(x, axis=0, weights=weights) for x in (source, target)
        )
        expected, _ = Rotation.align_vectors(target - target_mean, source - source_mean, weights)
        np.testing.assert_allclose(T[:3, :3], expected.as_matrix(), atol=1e-9)
        np.testing.assert_allclose(
            T[:3, 3], target_mean - expected.as_matrix() @ source_mean, atol=1e-9
        )
        assert_rigid(T, 1e-12)


def test_a_mirror_image_still_gives_a_rotation() -> None:
    source = torch.from_numpy(np.random.default_rng(3).normal(size=(30, 3)))
    T = weighted_kabsch(source, source * torch.tensor([1.0, 1.0, -1.0]), torch.ones(30).double())
    assert_rigid(T, 1e-12)


def degenerate(dtype: torch.dtype) -> dict[str, tuple[Tensor, Tensor, Tensor]]:
    rng = np.random.default_rng(4)
    cloud = torch.from_numpy(rng.normal(size=(8, 3))).to(dtype)
    line = cloud[:, :1] * torch.tensor([0.3, -0.4, 0.5], dtype=dtype)
    plane = cloud * torch.tensor([1.0, 1.0, 0.0], dtype=dtype)
    square = torch.tensor([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]] * 2, dtype=dtype)
    ones = torch.ones(8, dtype=dtype)
    return {
        "coplanar": (plane, plane.roll(1, 1), ones),
        "collinear": (line, line.roll(1, 1), ones),
        "collinear far away": (line + 1e4, line.roll(1, 1) - 1e4, ones),
        "collinear against a cloud": (line, cloud, ones),
        "coincident": (cloud[:1].expand(8, 3), cloud[1:2].expand(8, 3), ones),
        "all zero": (cloud * 0, cloud * 0, ones),
        "zero weights": (cloud, cloud.flip(0), ones * 0),
        "subnormal weights": (cloud, cloud.flip(0), ones * 5e-324),
        "one weight": (cloud, cloud.flip(0), torch.eye(8, dtype=dtype)[0]),
        "two weights": (cloud, cloud.flip(0), torch.eye(8, dtype=dtype)[:2].sum(0)),
        "equal singular values": (square, square, ones),
        "cube corners": (torch.eye(3, dtype=dtype), torch.eye(3, dtype=dtype), ones[:3]),
        "mirrored cube corners": (torch.eye(3, dtype=dtype), -torch.eye(3, dtype=dtype), ones[:3]),
        "tiny": (cloud * 1e-12, cloud.flip(0) * 1e-12, ones),
    }


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("case", sorted(degenerate(torch.float64)))
def test_degenerate_pairs_give_a_rotation_and_finite_gradients(
    case: str, dtype: torch.dtype
) -> None:
    inputs = [x.clone().requires_grad_() for x in degenerate(dtype)[case]]
    T = weighted_kabsch(*inputs)
    assert_rigid(T.detach(), 1e-5 if dtype == torch.float32 else 1e-12)
    (T * torch.arange(16.0).reshape(4, 4).to(dtype).sin()).sum().backward()
    for value in inputs:
        assert value.grad is not None
        assert bool(torch.isfinite(value.grad).all())


def test_gradcheck_with_repeated_singular_values_too() -> None:
    rng = np.random.default_rng(5)
    for case in ("general", "coplanar", "equal singular values", "cube corners"):
        if case == "general":
            source, target = torch.from_numpy(rng.normal(size=(2, 2, 6, 3)))
            weights = torch.from_numpy(rng.uniform(0.2, 1.0, (2, 6)))
        else:
            source, target, weights = degenerate(torch.float64)[case]
        inputs = tuple(x.clone().requires_grad_() for x in (source, target, weights))
        assert torch.autograd.gradcheck(weighted_kabsch, inputs, atol=1e-6)


def test_gradcheck_of_the_nearest_rotation() -> None:
    matrix = torch.from_numpy(np.random.default_rng(6).normal(size=(5, 3, 3))).requires_grad_()
    assert torch.autograd.gradcheck(nearest_rotation, (matrix,), atol=1e-6)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_batch_equals_the_loop(dtype: torch.dtype) -> None:
    rng = np.random.default_rng(7)
    source, target = torch.from_numpy(rng.normal(size=(2, 3, 4, 10, 3))).to(dtype)
    weights = torch.from_numpy(rng.uniform(size=(3, 4, 10))).to(dtype)
    batch = weighted_kabsch(source, target, weights)
    assert batch.shape == (3, 4, 4, 4)
    assert batch.dtype == dtype
    for i in np.ndindex(3, 4):
        one = weighted_kabsch(source[i], target[i], weights[i])
        torch.testing.assert_close(batch[i], one, atol=1e-5, rtol=1e-5)
