"""Normal equations against automatic differentiation; steps on regular and singular systems."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fullturn.pose.residuals import gauss_newton_step, normal_equations


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


@pytest.mark.parametrize("share", [0.0, 0.05, 0.3, 1.0])
def test_agrees_with_automatic_differentiation(share: float) -> None:
    data = problem(30)
    H, g = normal_equations(*data, point_share=share)
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
    H, g = normal_equations(at, difference, normal, weight, point_share=share)
    np.testing.assert_allclose(H, H_sum, atol=1e-12)
    np.testing.assert_allclose(g, g_sum, atol=1e-12)


def test_a_batch_equals_the_loop_and_weightless_points_are_nothing() -> None:
    data = problem(20, seed=2, batch=(2, 3))
    H, g = normal_equations(*data, point_share=0.2)
    assert H.shape == (2, 3, 6, 6)
    assert g.shape == (2, 3, 6)
    for i in np.ndindex(2, 3):
        H_one, g_one = normal_equations(*(x[i] for x in data), point_share=0.2)
        torch.testing.assert_close(H[i], H_one)
        torch.testing.assert_close(g[i], g_one)
    at, difference, normal, weight = (x[0, 0] for x in data)
    weight = weight.clone()
    weight[12:] = 0.0
    whole = normal_equations(at, difference, normal, weight, point_share=0.2)
    part = normal_equations(at[:12], difference[:12], normal[:12], weight[:12], point_share=0.2)
    torch.testing.assert_close(whole, part)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_step_solves_a_regular_system(dtype: torch.dtype) -> None:
    H, g = normal_equations(*(x.to(dtype) for x in problem(200, seed=3)), point_share=0.3)
    expected = -np.linalg.solve(H.double().numpy(), g.double().numpy())
    step = gauss_newton_step(H, g, damping=1e-6)
    np.testing.assert_allclose(step.double().numpy(), expected, rtol=2e-3, atol=1e-6)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_open_directions_stay_still(dtype: torch.dtype, scale: float) -> None:
    # Points of a plane pull along its normal only: the turn about it and the two slides are open.
    rng = np.random.default_rng(4)
    at = torch.from_numpy(rng.uniform(-1, 1, (50, 3))).to(dtype) * torch.tensor([1.0, 1.0, 0.0])
    at = at.to(dtype)
    up = torch.tensor([0.0, 0.0, 1.0], dtype=dtype).expand(50, 3)
    weight = torch.full((50,), scale, dtype=dtype)
    H, g = normal_equations(at, 0.02 * up, up, weight, point_share=0.0)
    assert int(torch.linalg.matrix_rank(H.double(), hermitian=True, rtol=1e-5)) == 3
    step = gauss_newton_step(H, g, damping=1e-3)
    torch.testing.assert_close(step[5], torch.tensor(-0.02, dtype=dtype), rtol=1e-2, atol=0)
    assert float(step[:5].abs().max()) < 1e-4


def test_nothing_pulls_nothing_moves_and_steps_are_bounded() -> None:
    still = gauss_newton_step(torch.zeros(3, 6, 6), torch.zeros(3, 6), damping=0.01)
    assert float(still.abs().max()) == 0.0
    eye = torch.eye(6).double()
    pull = torch.tensor([3.0, -3.0, 0.1, 0.0, -9.0, 0.2]).double()
    expected = torch.tensor([-0.5, 0.5, -0.1, 0.0, 0.5, -0.2]).double()
    torch.testing.assert_close(gauss_newton_step(eye, pull, damping=0.0), expected)
    held = gauss_newton_step(eye, pull, damping=0.0, largest=0.05)
    assert float(held.abs().max()) == pytest.approx(0.05)
    damped = gauss_newton_step(2 * eye, pull, damping=1.0, largest=9.0)
    torch.testing.assert_close(damped, -pull / 4)
