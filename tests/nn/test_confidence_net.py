"""The confidence network: what a fresh one does, and the shipped weights."""

from __future__ import annotations

import torch

from fullturn.nn.confidence import ConfidenceNet, ConfidenceNetConfig, load_confidence_net
from fullturn.pose.confidence import INPUTS


def test_a_fresh_network_changes_nothing() -> None:
    network = ConfidenceNet(ConfidenceNetConfig(("a", "b", "c")))
    found = network(torch.randn(4, 5, 3))
    torch.testing.assert_close(found, torch.tensor([1.0, 0.0]).expand(4, 5, 2))


def test_the_factor_is_above_zero_and_far_inputs_are_cut_off() -> None:
    torch.manual_seed(0)
    network = ConfidenceNet(ConfidenceNetConfig(("a", "b"), width=4))
    torch.nn.init.normal_(network.output.weight)
    torch.nn.init.constant_(network.output.bias, -2.0)
    found = network(3 * torch.randn(200, 2)).detach()
    assert bool((found[:, 0] > 0).all())
    assert float(found[:, 0].std()) > 0
    torch.testing.assert_close(network(torch.tensor([9.0, 0.0])), network(torch.tensor([4.0, 0.0])))


def test_the_weights_in_the_package_fit_the_inputs() -> None:
    network = load_confidence_net()
    assert network is not None
    assert not network.training
    assert network.config.inputs == INPUTS
    assert float(network.deviation.min()) > 0.0
