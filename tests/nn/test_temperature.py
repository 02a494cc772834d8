"""The temperature network: its size, its symmetry, and that padding leaves no trace."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from fullturn.nn.temperature import TemperatureNet


def net() -> TemperatureNet:
    """A network with weights of its own, norms included."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = TemperatureNet().double()
        with torch.no_grad():
            for parameter in model.parameters():
                parameter.add_(0.05 * torch.randn_like(parameter))
    return model


def cloud(count: int, *, seed: int) -> Tensor:
    return torch.from_numpy(np.random.default_rng(seed).normal(size=(2, count, 3)))


def everything(points: Tensor) -> Tensor:
    return torch.ones(points.shape[:2], dtype=torch.bool)


def predict(model: TemperatureNet, source: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    alpha, beta = model(source, target, everything(source), everything(target))
    return alpha, beta


def by_layers(model: TemperatureNet, source: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """The same with channels first, 1×1 convolutions and PyTorch's group normalization."""
    x = torch.cat([F.pad(source, (0, 1), value=0.0), F.pad(target, (0, 1), value=1.0)], 1).mT
    for layer in model.shared:
        x = F.conv1d(x, layer.linear.weight[..., None], layer.linear.bias)
        x = F.group_norm(x, layer.norm.num_groups, layer.norm.weight, layer.norm.bias).relu()
    x = F.adaptive_max_pool1d(x, 1).squeeze(-1)
    for layer in model.pooled:
        x = F.linear(x, layer.linear.weight, layer.linear.bias)
        x = F.group_norm(x, layer.norm.num_groups, layer.norm.weight, layer.norm.bias).relu()
    beta, alpha = F.softplus(F.linear(x, model.last.weight, model.last.bias)).unbind(-1)
    return alpha, beta


def test_agrees_with_convolutions_and_group_norm() -> None:
    model, source, target = net(), cloud(30, seed=1), cloud(20, seed=2)
    found, expected = predict(model, source, target), by_layers(model, source, target)
    torch.testing.assert_close(found, expected)
    assert found[0].shape == found[1].shape == (2,)


def test_number_of_parameters() -> None:
    assert sum(p.numel() for p in TemperatureNet().parameters()) == 809_922


def test_both_are_positive_and_differ_between_pairs() -> None:
    alpha, beta = predict(net(), 20.0 * cloud(30, seed=3), cloud(20, seed=4))
    for value in (alpha, beta):
        assert bool((value > 0).all())
        assert float((value[0] - value[1]).detach().abs()) > 1e-6


def test_order_is_nothing_and_which_cloud_is_which_is_something() -> None:
    model, source, target = net(), cloud(30, seed=5), cloud(20, seed=6)
    expected = predict(model, source, target)
    shuffled = torch.from_numpy(np.random.default_rng(7).permutation(30))
    torch.testing.assert_close(predict(model, source[:, shuffled], target), expected)
    swapped = predict(model, target, source)
    assert float((swapped[0] - expected[0]).detach().abs().max()) > 1e-6


@pytest.mark.parametrize("fill", [0.0, 1e3])
def test_padding_leaves_no_trace(fill: float) -> None:
    model, source, target = net(), cloud(30, seed=8), cloud(20, seed=9)
    source_mask, target_mask = everything(source), everything(target)
    source_mask[0, 25:] = False
    target_mask[1, 11:] = False
    source, target = (x.clone() for x in (source, target))
    source[0, 25:], target[1, 11:] = fill, fill
    alpha, beta = model(source, target, source_mask, target_mask)
    for i, (n, m) in enumerate([(25, 20), (30, 11)]):
        alone = predict(model, source[i : i + 1, :n], target[i : i + 1, :m])
        torch.testing.assert_close((alpha[i : i + 1], beta[i : i + 1]), alone)


def test_gradients_reach_every_parameter_and_stay_finite() -> None:
    model = net().float()
    same = torch.zeros(2, 6, 3)  # a cloud without extent
    for source in (same, cloud(6, seed=10).float()):
        model.zero_grad()
        alpha, beta = predict(model, source, cloud(5, seed=11).float())
        (alpha.sum() + 2.0 * beta.sum()).backward()
        for name, parameter in model.named_parameters():
            assert parameter.grad is not None, name
            assert bool(torch.isfinite(parameter.grad).all()), name
