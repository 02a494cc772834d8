"""Energies agree with the formula, written as loops over all pairs of points."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from fullturn.matching.energy import FusedEnergy, TermEnergy, squared_distances

CHANNELS = (16, 8, 4, 2)


def terms_of(count: int, *, seed: int, dtype: torch.dtype = torch.float64) -> tuple[Tensor, ...]:
    rng = np.random.default_rng(seed)
    return tuple(torch.from_numpy(rng.normal(size=(2, count, c))).to(dtype) for c in CHANNELS)


def test_terms_by_loops() -> None:
    energy = TermEnergy(CHANNELS).double()
    with torch.no_grad():
        energy.log_weights.copy_(torch.tensor([0.25, -1.0, 0.0, 2.0]))
    source, target = terms_of(5, seed=1), terms_of(4, seed=2)
    found = energy(source, target)
    assert found.shape == (2, 5, 4)
    for b, i, j in np.ndindex(2, 5, 4):
        expected = sum(
            math.exp([0.25, -1.0, 0.0, 2.0][t])
            * float((source[t][b, i] - target[t][b, j]).square().sum())
            / math.sqrt(CHANNELS[t])
            for t in range(len(CHANNELS))
        )
        assert float(found[b, i, j].detach()) == pytest.approx(expected, rel=1e-12)


def test_fused_by_loops() -> None:
    energy = FusedEnergy(CHANNELS, width=12).double()
    source, target = terms_of(5, seed=3), terms_of(4, seed=4)
    found = energy(source, target)
    for b, i, j in np.ndindex(2, 5, 4):
        x, y = (torch.cat([term[b, k] for term in s]) for s, k in ((source, i), (target, j)))
        mapped = energy.fuse.weight @ (x - y)
        expected = float(mapped.detach().square().sum()) / math.sqrt(12)
        assert float(found[b, i, j].detach()) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("kind", [FusedEnergy, TermEnergy])
def test_symmetric_and_smallest_for_equal_points(kind: type[FusedEnergy | TermEnergy]) -> None:
    energy = kind(CHANNELS).double()
    source, target = terms_of(6, seed=5), terms_of(7, seed=6)
    torch.testing.assert_close(energy(source, target), energy(target, source).mT)
    same = energy(source, source)
    torch.testing.assert_close(same.diagonal(dim1=-2, dim2=-1), torch.zeros(2, 6).double())
    torch.testing.assert_close(same.argmin(-1), torch.arange(6).expand(2, 6))


@pytest.mark.parametrize("kind", [FusedEnergy, TermEnergy])
def test_gradients_reach_every_parameter(kind: type[FusedEnergy | TermEnergy]) -> None:
    energy = kind(CHANNELS)
    source, target = (terms_of(5, seed=s, dtype=torch.float32) for s in (7, 8))
    energy(source, target).sum().backward()
    for parameter in energy.parameters():
        assert parameter.grad is not None
        assert bool((parameter.grad != 0).all())


def test_numbers_of_parameters() -> None:
    released = sum(p.numel() for p in FusedEnergy((128, 128, 32, 8)).parameters())
    assert released == (128 + 128 + 32 + 8) * 128
    assert sum(p.numel() for p in TermEnergy((128, 128, 32, 8)).parameters()) == 4


def test_squared_distances_in_float32() -> None:
    rng = np.random.default_rng(9)
    source, target = (torch.from_numpy(rng.normal(size=(3, k, 128))) for k in (50, 40))
    expected = torch.cdist(source, target).square()
    found = squared_distances(source.float(), target.float())
    torch.testing.assert_close(found.double(), expected, atol=1e-3, rtol=1e-6)
    inputs = (source[:1, :3, :4].clone().requires_grad_(), target[:1, :2, :4].clone())
    assert torch.autograd.gradcheck(squared_distances, inputs)
