from __future__ import annotations

import torch

from fullturn.geometry.step import unit_step


def test_the_step_is_a_comparison() -> None:
    values = torch.randn(100, 7, generator=torch.Generator().manual_seed(0))
    values[0, :4] = torch.tensor([0.0, -0.0, 1e-38, -1e-38])
    expected = (values > 0).float()
    assert torch.equal(unit_step(values), expected)
    assert torch.equal(values, expected)  # in place


def test_differences_are_above_zero_exactly_where_one_is_larger() -> None:
    large = torch.tensor([1.0, 1e30, 1e-30])
    above = torch.nextafter(large, torch.full_like(large, torch.inf))
    assert torch.equal(unit_step(above - large), torch.ones(3))
    assert torch.equal(unit_step(large - above), torch.zeros(3))
