"""Rigid motions: group axioms, exponential and logarithm at every angle, against SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from fullturn.geometry import rigid

ANGLES = {
    "zero": 0.0,
    "1e-9": 1e-9,
    "1e-4": 1e-4,
    "series limit": math.sqrt(0.1),
    "generic": 1.7,
    "near pi": math.pi - 1e-4,
    "1e-9 from pi": math.pi - 1e-9,
}
BATCHES = [(), (5,), (2, 3)]
TOLERANCE = {torch.float64: 1e-12, torch.float32: 2e-5}


def rotation_vectors(angle: float, batch: tuple[int, ...], dtype: torch.dtype) -> torch.Tensor:
    axis = torch.from_numpy(np.random.default_rng(3).standard_normal((*batch, 3)))
    return (angle * axis / axis.norm(dim=-1, keepdim=True)).to(dtype)


def motions(batch: tuple[int, ...], dtype: torch.dtype, *, seed: int = 0) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    R = rigid.random_rotations_uniform(math.prod(batch), rng=rng).view(*batch, 3, 3)
    return rigid.make(R, torch.from_numpy(rng.standard_normal((*batch, 3)))).to(dtype)


@pytest.mark.parametrize("dtype", TOLERANCE)
@pytest.mark.parametrize("batch", BATCHES)
def test_group_axioms(batch: tuple[int, ...], dtype: torch.dtype) -> None:
    tolerance = TOLERANCE[dtype]
    A, B = (motions(batch, dtype, seed=seed) for seed in range(2))
    identity = torch.eye(4, dtype=dtype).expand_as(A)
    points = torch.from_numpy(np.random.default_rng(1).standard_normal((*batch, 7, 3))).to(dtype)
    close = {"rtol": 0, "atol": tolerance}
    torch.testing.assert_close(A @ rigid.invert(A), identity, **close)
    torch.testing.assert_close(rigid.invert(A) @ A, identity, **close)
    torch.testing.assert_close(rigid.invert(A @ B), rigid.invert(B) @ rigid.invert(A), **close)
    torch.testing.assert_close(
        rigid.apply(A, rigid.apply(B, points)), rigid.apply(A @ B, points), **close
    )


def test_apply_moves_every_row_and_broadcasts() -> None:
    T = motions((4,), torch.float64)
    points = torch.from_numpy(np.random.default_rng(1).standard_normal((6, 3)))
    moved = rigid.apply(T, points)
    assert moved.shape == (4, 6, 3)
    for i in range(4):
        for j in range(6):
            torch.testing.assert_close(moved[i, j], T[i, :3, :3] @ points[j] + T[i, :3, 3])


@pytest.mark.parametrize("dtype", TOLERANCE)
@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize("angle", ANGLES.values(), ids=ANGLES)
def test_exp_and_log_are_inverse(angle: float, batch: tuple[int, ...], dtype: torch.dtype) -> None:
    vector = rotation_vectors(angle, batch, dtype)
    R = rigid.exp_so3(vector)
    identity = torch.eye(3, dtype=dtype).expand_as(R)
    torch.testing.assert_close(R @ R.mT, identity, rtol=0, atol=10 * TOLERANCE[dtype])
    back = rigid.log_so3(R)
    if angle > 3 and dtype == torch.float32:
        # Near π rounding may pick the opposite axis: compare the rotations.
        torch.testing.assert_close(rigid.exp_so3(back), R, rtol=0, atol=1e-5)
    else:
        torch.testing.assert_close(back, vector, rtol=0, atol=TOLERANCE[dtype])
    assert back.norm(dim=-1).max() <= math.pi + TOLERANCE[dtype]

    twist = torch.cat([vector, torch.ones_like(vector)], dim=-1)
    T = rigid.exp_se3(twist)
    torch.testing.assert_close(
        rigid.exp_se3(rigid.log_se3(T)), T, rtol=0, atol=20 * TOLERANCE[dtype]
    )
    if angle < 3:
        torch.testing.assert_close(rigid.log_se3(T), twist, rtol=0, atol=20 * TOLERANCE[dtype])


@pytest.mark.parametrize("angle", ANGLES.values(), ids=ANGLES)
def test_rotations_agree_with_scipy(angle: float) -> None:
    vector = rotation_vectors(angle, (20,), torch.float64)
    expected = Rotation.from_rotvec(vector.numpy())
    R = rigid.exp_so3(vector)
    np.testing.assert_allclose(R.numpy(), expected.as_matrix(), rtol=0, atol=1e-14)
    ours = rigid.log_so3(torch.from_numpy(expected.as_matrix())).numpy()
    np.testing.assert_allclose(ours, expected.as_rotvec(), rtol=0, atol=1e-12)
    np.testing.assert_allclose(rigid.rotation_angle_rad(R).numpy(), angle, rtol=0, atol=1e-14)


def test_exp_se3_is_the_matrix_exponential() -> None:
    twist = torch.from_numpy(np.random.default_rng(0).standard_normal((20, 6)))
    generator = torch.zeros(20, 4, 4, dtype=torch.float64)
    x, y, z = twist[:, :3].unbind(-1)
    generator[:, 0, 1], generator[:, 0, 2], generator[:, 1, 2] = -z, y, -x
    generator[:, 1, 0], generator[:, 2, 0], generator[:, 2, 1] = z, -y, x
    generator[:, :3, 3] = twist[:, 3:]
    torch.testing.assert_close(
        rigid.exp_se3(twist), torch.linalg.matrix_exp(generator), rtol=0, atol=1e-13
    )


def test_skew_is_the_cross_product() -> None:
    a, b = torch.from_numpy(np.random.default_rng(5).normal(size=(2, 4, 7, 3)))
    crossed = (rigid.skew(a) @ b.unsqueeze(-1)).squeeze(-1)
    torch.testing.assert_close(crossed, torch.linalg.cross(a, b))
    torch.testing.assert_close(rigid.skew(a), -rigid.skew(a).mT)


def test_small_angles_keep_their_digits() -> None:
    vector = rotation_vectors(1e-9, (50,), torch.float64)
    torch.testing.assert_close(rigid.log_so3(rigid.exp_so3(vector)), vector, rtol=1e-14, atol=0)


@pytest.mark.parametrize(
    "vector",
    [[math.pi, 0, 0], [0, math.pi, 0], [0, 0, -math.pi], [math.pi / math.sqrt(3)] * 3],
)
def test_half_turns(vector: list[float]) -> None:
    half_turn = torch.tensor(vector, dtype=torch.float64)
    R = Rotation.from_rotvec(half_turn.numpy()).as_matrix()
    back = rigid.log_so3(torch.from_numpy(R))
    assert abs(float(back.norm()) - math.pi) < 1e-12
    assert min(float((back - half_turn).norm()), float((back + half_turn).norm())) < 1e-12


@pytest.mark.parametrize("dtype", TOLERANCE)
@pytest.mark.parametrize("angle", [*ANGLES.values(), math.pi], ids=[*ANGLES, "pi"])
def test_no_nan_in_values_or_gradients(angle: float, dtype: torch.dtype) -> None:
    vector = rotation_vectors(angle, (6,), dtype)
    twist = torch.cat([vector, torch.ones_like(vector)], dim=-1)
    checks = [
        (rigid.exp_so3, vector),
        (rigid.log_so3, rigid.exp_so3(vector)),
        (rigid.exp_se3, twist),
        (rigid.log_se3, rigid.exp_se3(twist)),
        (rigid.rotation_angle_rad, rigid.exp_so3(vector)),
    ]
    for function, value in checks:
        leaf = value.detach().clone().requires_grad_()
        result = function(leaf)
        result.sum().backward()
        assert torch.isfinite(result).all(), function.__name__
        assert leaf.grad is not None
        assert torch.isfinite(leaf.grad).all(), function.__name__


@pytest.mark.parametrize("angle", [1e-9, 0.3, math.sqrt(0.1) + 1e-4, 2.0])
def test_gradients_match_finite_differences(angle: float) -> None:
    vector = rotation_vectors(angle, (), torch.float64)
    twist = torch.cat([vector, torch.tensor([0.3, -1.0, 2.0], dtype=torch.float64)])
    assert torch.autograd.gradcheck(rigid.exp_se3, (twist.requires_grad_(),))
    assert torch.autograd.gradcheck(
        lambda v: rigid.log_se3(rigid.exp_se3(v)), (twist.detach().requires_grad_(),)
    )


def test_rotation_from_axis_angle_ignores_the_axis_length() -> None:
    axis = torch.tensor([0.0, 0.0, 7.0], dtype=torch.float64)
    R = rigid.rotation_from_axis_angle(axis, torch.tensor(math.pi / 2, dtype=torch.float64))
    expected = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], dtype=torch.float64)
    torch.testing.assert_close(R, expected, rtol=0, atol=1e-15)
    zero = rigid.rotation_from_axis_angle(0 * axis, torch.tensor(1.0, dtype=torch.float64))
    torch.testing.assert_close(zero, torch.eye(3, dtype=torch.float64))


def test_uniform_rotations_have_the_stated_mean_angle() -> None:
    R = rigid.random_rotations_uniform(20_000, rng=np.random.default_rng(0))
    assert R.dtype == torch.float64
    torch.testing.assert_close(
        R @ R.mT, torch.eye(3, dtype=torch.float64).expand_as(R), rtol=0, atol=1e-13
    )
    assert torch.linalg.det(R).min() > 0.999
    angle_deg = torch.rad2deg(rigid.rotation_angle_rad(R))
    assert abs(float(angle_deg.mean()) - 126.5) < 1.5
    # Haar measure has no preferred direction: every matrix entry averages to 0.
    assert R.mean(0).abs().max() < 0.02


def test_uniform_rotations_repeat_with_the_seed() -> None:
    first, second = (
        rigid.random_rotations_uniform(4, rng=np.random.default_rng(5)) for _ in range(2)
    )
    assert torch.equal(first, second)
