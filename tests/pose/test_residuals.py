"""Normal equations against automatic differentiation; steps on regular and singular systems."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fullturn.pose.closest_pairs import normal_equations
from fullturn.pose.residuals import gauss_newton_step, plane_equations


def problem(count: int, *, seed: int = 0, batch: tuple[int, ...] = ()) -> tuple[Tensor, ...]:
    rng = np.random.default_rng(seed)
    at, difference, normal = torch.from_numpy(rng.normal(size=(3, *batch, count, 3)))
    normal = normal / normal.norm(dim=-1, keepdim=True)
    return at, 0.1 * difference, normal, torch.from_numpy(rng.uniform(0, 2, (*batch, count)))


def cost(
    motion: Tensor, at: Tensor, difference: Tensor, normal: Tensor, weight: Tensor, share: float
) -> Tensor:
    """Half the weighted squared error after the small motion (ω, v)."""
    moved = difference + torch.linalg.cross(motion[:3].expand_as(at), at) + motion[3:]
    height = (moved * normal).sum(-1)
    squares = (1 - share) * height.square() + share * moved.square().sum(-1)
    return (weight * squares).sum() / 2


def in_numpy(
    at: Tensor, difference: Tensor, normal: Tensor, weight: Tensor, *, share: float
) -> tuple[Tensor, Tensor]:
    """Of one pose, planes and points; the others are of planes alone, for many poses."""
    planes = (rows.T.numpy() for rows in (at, difference, normal))
    H, g = normal_equations(*planes, weight.numpy(), point_share=share)
    return torch.from_numpy(H), torch.from_numpy(g)


def in_torch(
    at: Tensor, difference: Tensor, normal: Tensor, weight: Tensor
) -> tuple[Tensor, Tensor]:
    return plane_equations(*(rows.movedim(-1, 0) for rows in (at, difference, normal)), weight)


@pytest.mark.parametrize("share", [0.0, 0.05, 0.3, 1.0])
def test_agrees_with_automatic_differentiation(share: float) -> None:
    data = problem(30)
    H, g = in_numpy(*data, share=share)
    origin = torch.zeros(6, dtype=torch.float64)

    def function(motion: Tensor) -> Tensor:
        return cost(motion, *data, share)

    torch.testing.assert_close(H, torch.autograd.functional.hessian(function, origin))
    torch.testing.assert_close(g, torch.autograd.functional.jacobian(function, origin))
    torch.testing.assert_close(H, H.mT)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_agrees_with_explicit_jacobians(share: float) -> None:
    at, difference, normal, weight = problem(25, seed=1)
    H_sum, g_sum = np.zeros((6, 6)), np.zeros(6)
    for x, r, n, w in zip(*(v.numpy() for v in (at, difference, normal, weight)), strict=True):
        J = np.column_stack([*(np.cross(axis, x) for axis in np.eye(3)), np.eye(3)])
        W = (1 - share) * np.outer(n, n) + share * np.eye(3)
        H_sum += w * J.T @ W @ J
        g_sum += w * J.T @ W @ r
    H, g = in_numpy(at, difference, normal, weight, share=share)
    np.testing.assert_allclose(H, H_sum, atol=1e-12)
    np.testing.assert_allclose(g, g_sum, atol=1e-12)


def test_planes_alone_are_the_same_for_one_pose_and_for_many() -> None:
    data = problem(20, seed=2, batch=(2, 3))
    H, g = in_torch(*data)
    assert H.shape == (2, 3, 6, 6)
    assert g.shape == (2, 3, 6)
    for i in np.ndindex(2, 3):
        H_one, g_one = in_numpy(*(x[i] for x in data), share=0.0)
        torch.testing.assert_close(H[i], H_one)
        torch.testing.assert_close(g[i], g_one)


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_weightless_points_are_nothing(share: float) -> None:
    at, difference, normal, weight = problem(20, seed=2)
    weight[12:] = 0.0
    whole = in_numpy(at, difference, normal, weight, share=share)
    part = in_numpy(at[:12], difference[:12], normal[:12], weight[:12], share=share)
    torch.testing.assert_close(whole, part)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_step_solves_a_regular_system(dtype: torch.dtype) -> None:
    H, g = in_torch(*(x.to(dtype) for x in problem(200, seed=3)))
    expected = -np.linalg.solve(H.double().numpy(), g.double().numpy())
    step = gauss_newton_step(H.numpy(), g.numpy(), damping=1e-6)
    np.testing.assert_allclose(step, expected, rtol=2e-3, atol=1e-6)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_open_directions_stay_still(dtype: torch.dtype, scale: float) -> None:
    # Points of a plane pull along its normal only: the turn about it and the two slides are open.
    rng = np.random.default_rng(4)
    at = torch.from_numpy(rng.uniform(-1, 1, (50, 3))).to(dtype) * torch.tensor([1.0, 1.0, 0.0])
    at = at.to(dtype)
    up = torch.tensor([0.0, 0.0, 1.0], dtype=dtype).expand(50, 3)
    weight = torch.full((50,), scale, dtype=dtype)
    H, g = in_torch(at, 0.02 * up, up, weight)
    assert int(torch.linalg.matrix_rank(H.double(), hermitian=True, rtol=1e-5)) == 3
    step = gauss_newton_step(H.numpy(), g.numpy(), damping=1e-3)
    assert step.dtype == H.numpy().dtype
    assert step[5] == pytest.approx(-0.02, rel=1e-2)
    assert np.abs(step[:5]).max() < 1e-4


def test_nothing_pulls_nothing_moves_and_steps_are_bounded() -> None:
    still = gauss_newton_step(np.zeros((3, 6, 6)), np.zeros((3, 6)), damping=0.01)
    assert np.abs(still).max() == 0.0
    pull = np.array([3.0, -3.0, 0.1, 0.0, -9.0, 0.2])
    expected = np.array([-0.5, 0.5, -0.1, 0.0, 0.5, -0.2])
    np.testing.assert_allclose(gauss_newton_step(np.eye(6), pull, damping=0.0), expected)
    held = gauss_newton_step(np.eye(6), pull, damping=0.0, largest=0.05)
    assert np.abs(held).max() == pytest.approx(0.05)
    damped = gauss_newton_step(2 * np.eye(6), pull, damping=1.0, largest=9.0)
    np.testing.assert_allclose(damped, -pull / 4)
