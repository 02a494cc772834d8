"""The evidence network: what must not matter to it, and what must."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from fullturn.nn.evidence import EvidenceNet, EvidenceNetConfig, load_evidence_net
from fullturn.pose.evidence import COMPARED, SIGNALS

CONFIG = EvidenceNetConfig(("a", "b", "c", "d"), ("b", "d"), width=8)


@pytest.fixture
def network() -> EvidenceNet:
    torch.manual_seed(0)
    return EvidenceNet(CONFIG).eval()


def signals(poses: int, points: int = 20, seed: int = 1) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    values = torch.randn(poses, 2, points, 4, generator=generator)
    return values, torch.rand(2, points, generator=generator).expand(poses, -1, -1)


def test_the_order_of_points_clouds_and_poses_is_nothing(network: EvidenceNet) -> None:
    values, area = signals(6)
    found = network(values, area)
    points = torch.randperm(20, generator=torch.Generator().manual_seed(2))
    torch.testing.assert_close(network(values[:, :, points], area[:, :, points]), found)
    torch.testing.assert_close(network(values.flip(1), area.flip(1)), found)
    poses = torch.tensor([3, 0, 5, 1, 2, 4])
    torch.testing.assert_close(network(values[poses], area[poses]), found[poses])


def test_points_of_no_area_are_not_there(network: EvidenceNet) -> None:
    values, area = signals(3)
    nothing = torch.nn.functional.pad(area, (0, 5))
    padded = torch.nn.functional.pad(values, (0, 0, 0, 5), value=7.0)
    torch.testing.assert_close(network(padded, nothing), network(values, area))
    # Halves of points, given twice, are as good as the points.
    twice = network(values.repeat(1, 1, 2, 1), area.repeat(1, 1, 2) / 2)
    torch.testing.assert_close(twice, network(values, area))


def test_rivals_are_those_of_one_pair(network: EvidenceNet) -> None:
    one, two = signals(4, seed=3), signals(3, seed=4)
    expected = torch.cat([network(*one), network(*two)])
    values, area = (torch.cat(parts) for parts in zip(one, two, strict=True))
    pair = torch.tensor([0, 0, 0, 0, 1, 1, 1])
    torch.testing.assert_close(network(values, area, pair), expected)
    assert not torch.allclose(network(values, area), expected)


def test_a_rival_matters_by_its_points_and_as_a_whole(network: EvidenceNet) -> None:
    values, area = signals(2)
    before = network(values, area)
    # The same pose twice is no rival of itself.
    torch.testing.assert_close(network(values[[0, 1, 1]], area[[0, 1, 1]]), before[[0, 1, 1]])
    for signal in range(4):  # compared point by point, or not
        other = values.clone()
        other[1, ..., signal] = 0.0
        assert not torch.allclose(network(other, area)[0], before[0])


def test_every_weight_is_reached(network: EvidenceNet) -> None:
    network(*signals(5)).sum().backward()
    assert all(p.grad is not None and bool((p.grad != 0).any()) for p in network.parameters())


def test_the_weights_in_the_package_fit_the_signals() -> None:
    network = load_evidence_net()
    assert network is not None
    assert not network.training
    assert network.config.signals == SIGNALS
    assert network.config.compared == COMPARED
