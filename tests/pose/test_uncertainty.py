"""The covariance means what it says: which perturbation, which noise, how large errors are."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from pose_shapes import random_motions, teapot
from torch import Tensor

from fullturn.data.draw import ProtocolPairs
from fullturn.data.protocols import PROTOCOLS
from fullturn.data.shapes import ProceduralShapes
from fullturn.geometry import rigid
from fullturn.geometry.cloud import Cloud
from fullturn.pose.explain import partner_radius
from fullturn.pose.fine import refine_fine
from fullturn.pose.uncertainty import pose_covariance

T_TRUE = random_motions(1, seed=1)[0]


def covariance(source: Tensor, target: Tensor, T: Tensor = T_TRUE) -> Tensor:
    found = pose_covariance(T.numpy(), Cloud(source), Cloud(target), cutoff=0.1)
    return torch.from_numpy(found)


def noisy(noise: float, *, count: int = 2000, seed: int = 0) -> tuple[Tensor, Tensor]:
    """The same points twice, each with noise of its own, the target moved by the truth."""
    rng = np.random.default_rng(seed)
    points, _ = teapot(count)
    shaken = [points + noise * torch.from_numpy(rng.normal(size=points.shape)) for _ in range(2)]
    return shaken[0], rigid.apply(T_TRUE, shaken[1])


def adjoint(T: Tensor) -> Tensor:
    """Ad with g Exp(ξ) g⁻¹ = Exp(Ad ξ), rotation first."""
    R, t = T[:3, :3], T[:3, 3]
    cross = torch.stack([torch.linalg.cross(t, axis) for axis in torch.eye(3).double()], 1)
    Ad = torch.zeros(6, 6).double()
    Ad[:3, :3] = Ad[3:, 3:] = R
    Ad[3:, :3] = cross @ R
    return Ad


def test_it_is_symmetric_and_positive() -> None:
    C = covariance(*noisy(0.005))
    torch.testing.assert_close(C, C.mT, atol=0, rtol=0)
    assert float(torch.linalg.eigvalsh(C).min()) > 0.0


def test_the_perturbation_is_on_the_right_in_the_source_frame() -> None:
    source, target = noisy(0.005)
    C = covariance(source, target)
    g, h = random_motions(2, seed=2)
    size = float(C.diagonal().max())
    # Another target frame changes nothing; another source frame acts by its adjoint.
    elsewhere = covariance(source, rigid.apply(h, target), h @ T_TRUE)
    torch.testing.assert_close(elsewhere, C, atol=0.01 * size, rtol=0)
    turned = covariance(rigid.apply(g, source), target, T_TRUE @ rigid.invert(g))
    expected = adjoint(g) @ C @ adjoint(g).mT
    size = float(expected.diagonal().max())
    torch.testing.assert_close(turned, expected, atol=0.03 * size, rtol=0)


@pytest.mark.parametrize("noise", [5e-4, 2e-3])
def test_it_scales_with_the_square_of_the_noise(noise: float) -> None:
    once, twice = covariance(*noisy(noise)), covariance(*noisy(2 * noise))
    ratio = (twice.diagonal() / once.diagonal()).log().mean().exp()
    assert float(ratio) == pytest.approx(4.0, rel=0.3)


def test_more_points_hold_firmer() -> None:
    few, many = covariance(*noisy(2e-3, count=500)), covariance(*noisy(2e-3, count=4000))
    ratio = (few.diagonal() / many.diagonal()).log().mean().exp()
    assert float(ratio) == pytest.approx(8.0, rel=0.5)


def test_a_plane_leaves_its_slides_and_its_turn_loose() -> None:
    rng = np.random.default_rng(3)
    clouds = [
        torch.from_numpy(rng.uniform(-1, 1, (3000, 3)) * (1, 1, 0) + rng.normal(0, 1e-3, (3000, 3)))
        for _ in range(2)
    ]
    deviation = covariance(*clouds, T=torch.eye(4).double()).diagonal().sqrt()
    held, loose = deviation[[0, 1, 5]], deviation[[2, 3, 4]]
    assert float(loose.min()) > 5 * float(held.max())


def test_no_partner_no_knowledge() -> None:
    source, target = noisy(0.0, count=100)
    away = rigid.make(torch.eye(3).double(), torch.tensor([9.0, 0, 0]).double())
    torch.testing.assert_close(covariance(source, target, away), torch.eye(6).double())


@pytest.mark.parametrize("protocol", ["modelnet40/noisy/180", "modelnet40/noisy-resampled/180"])
def test_errors_are_as_large_as_it_says(protocol: str) -> None:
    # ξᵀ C⁻¹ ξ of six right numbers has a median of 5.3.
    squares = []
    for pair in ProtocolPairs(PROTOCOLS[protocol], ProceduralShapes(60, seed=3), count=48, seed=1):
        source, target = (torch.from_numpy(x) for x in (pair.source, pair.target))
        T_true = torch.from_numpy(pair.T_target_source).clone()
        T_true[:3, 3] += T_true[:3, :3] @ source.mean(0) - target.mean(0)
        clouds = Cloud(source - source.mean(0)), Cloud(target - target.mean(0))
        T = refine_fine(T_true, *clouds, start=2 * max(cloud.spacing for cloud in clouds))
        C = pose_covariance(T.numpy(), *clouds, cutoff=partner_radius(*clouds, T))
        error = rigid.log_se3(rigid.invert(T) @ T_true).numpy()
        squares.append(float(error @ np.linalg.solve(C, error)))
    assert 2.0 < float(np.median(squares)) < 12.0
    assert float(np.quantile(squares, 0.9)) < 40.0


def test_exact_partners_that_leave_the_pose_open_give_a_positive_covariance() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        line = torch.from_numpy(rng.uniform(-1, 1, (50, 1)) * rng.normal(size=3))
        C = covariance(line, line, torch.eye(4).double())
        values = torch.linalg.eigvalsh(C)
        assert float(values.min()) > -1e-12
        # The turn about the line is anyone's guess.
        assert float(values.max()) > 0.5
