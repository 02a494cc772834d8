"""The transformer: against G1 to G3 written as loops, and its gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from nn_reference import cloud, tpt

from fullturn.nn import tpt as module
from fullturn.nn.graphs import Level
from fullturn.nn.tpt import PointTransformer, PointwiseBlock


def case(k: int = 4) -> tuple[PointTransformer, torch.Tensor, Level]:
    rng = np.random.default_rng(0)
    block = PointTransformer(6, 16, 10, k=k, relation_channels=5).double()
    features = torch.from_numpy(rng.standard_normal((12, 6)))
    centers = torch.from_numpy(rng.permutation(12)[:7])
    others = torch.from_numpy(rng.integers(0, 12, (7, k - 1)))
    relation = torch.from_numpy(rng.standard_normal((7, k, 5)))
    return block, features, Level(centers, torch.cat([centers[:, None], others], 1), relation)


@pytest.mark.parametrize("at_once", [1, 1 << 17])
@pytest.mark.parametrize("with_gradient", [False, True])
def test_by_definition(with_gradient: bool, at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_VALUES_AT_ONCE", at_once)
    block, features, level = case()
    with torch.set_grad_enabled(with_gradient):
        result = block(features, level).detach().numpy()
    assert level.centers is not None
    for row, i in enumerate(level.centers.tolist()):
        rho = level.relation[row].numpy()
        expected = tpt(block, list(features.numpy()), i, level.neighbors[row].tolist(), rho)
        np.testing.assert_allclose(result[row], expected, rtol=0, atol=1e-12)


def test_every_point_is_a_center_by_default() -> None:
    block, features, _ = case()
    everyone = torch.arange(12)
    neighbors = torch.stack([everyone, everyone.flip(0), everyone.roll(1), everyone.roll(2)], 1)
    relation = torch.from_numpy(np.random.default_rng(1).standard_normal((12, 4, 5)))
    torch.testing.assert_close(
        block(features, Level(None, neighbors, relation)),
        block(features, Level(everyone, neighbors, relation)),
    )


def test_the_order_of_the_neighbors_matters() -> None:
    # As in the paper: G1 concatenates by distance. A mean over neighbors would not see it.
    block, features, level = case()
    order = [0, 2, 1, 3]
    other = Level(level.centers, level.neighbors[:, order], level.relation[:, order])
    assert (block(features, level) - block(features, other)).abs().max() > 1e-3


def test_gradients_by_differences() -> None:
    block, features, level = case()
    features.requires_grad_()
    assert torch.autograd.gradcheck(lambda x: block(x, level), [features])
    weights = [value.detach().clone().requires_grad_() for value in block.parameters()]
    names = [name for name, _ in block.named_parameters()]

    def of_weights(*values: torch.Tensor) -> torch.Tensor:
        parameters = dict(zip(names, values, strict=True))
        return torch.func.functional_call(block, parameters, (features.detach(), level))

    assert torch.autograd.gradcheck(of_weights, weights)


def test_without_attention_neighbors_have_no_say() -> None:
    block = PointwiseBlock(3, 8, 10).double()
    features = cloud(12, seed=0)
    _, _, level = case()
    assert level.centers is not None
    expected = block(features[level.centers], Level(None, level.neighbors, level.relation))
    torch.testing.assert_close(block(features, level), expected)
    other = Level(level.centers, level.neighbors.flip(0), level.relation)
    torch.testing.assert_close(block(features, other), expected)
