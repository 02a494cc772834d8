"""GMCNet as a whole: its steps, batches of unequal clouds, reuse, gradients, every variant."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.matching.sinkhorn import sinkhorn
from fullturn.methods.learned.gmcnet import GMCNet, Registered
from fullturn.nn.clouds import CloudBatch
from fullturn.nn.config import GMCNetConfig
from fullturn.pose.soft import soft_pose

SMALL = GMCNetConfig(channels=(32, 32, 16, 4))


def build(seed: int = 0, **changes: Any) -> GMCNet:
    """A small untrained network in evaluation mode, the same in every run."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return GMCNet(replace(SMALL, **changes)).eval()


def surface(count: int, *, seed: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """Points on a bumpy sphere of radius about 0.5."""
    direction = torch.from_numpy(np.random.default_rng(seed).normal(size=(count, 3)))
    direction = direction / direction.norm(dim=1, keepdim=True)
    bumps = 0.5 + 0.1 * (3.0 * direction[:, :1]).sin() + 0.05 * (5.0 * direction[:, 1:2]).cos()
    return (bumps * direction).to(dtype)


def batch(*sizes: int, seed: int = 0, dtype: torch.dtype = torch.float32) -> CloudBatch:
    return CloudBatch.collate([surface(n, seed=seed + n, dtype=dtype) for n in sizes])


def assert_rigid(T: Tensor, atol: float = 1e-5) -> None:
    R = T[:, :3, :3]
    torch.testing.assert_close(R @ R.mT, torch.eye(3).to(R).expand_as(R), atol=atol, rtol=0)
    torch.testing.assert_close(torch.linalg.det(R), torch.ones(len(R)).to(R), atol=atol, rtol=0)


VARIANTS: dict[str, dict[str, Any]] = {
    "plain": {},
    "rri": {"features": "rri"},
    "fpfh": {"features": "fpfh"},
    "ri only": {"rif_only": True},
    "terms": {"matching": "terms"},
    "predicted": {"temperature": "predicted"},
    "no graph": {"graph": False},
    "no transformer": {"tpt": False},
    "no hierarchy": {"hgm": False},
    "no hierarchy, terms": {"hgm": False, "matching": "terms"},
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant_gives_poses_and_gradients(variant: str) -> None:
    model = build(**VARIANTS[variant]).train()
    registered = model(batch(60, 48), batch(52, 52, seed=5))
    assert registered.matching.shape == (2, 60, 52)
    assert registered.matching_back.shape == (2, 52, 60)
    assert_rigid(registered.T_target_source.detach())
    assert_rigid(registered.T_source_target.detach())
    loss = registered.T_target_source.sum() + registered.T_source_target.square().sum()
    (loss + registered.matching.square().sum()).backward()
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None, name
        assert bool(torch.isfinite(parameter.grad).all()), name


@pytest.mark.parametrize("temperature", ["fixed", "predicted"])
@pytest.mark.parametrize("matching", ["fused", "terms"])
def test_the_steps_one_by_one(matching: Any, temperature: Any) -> None:
    model = build(matching=matching, temperature=temperature, alpha=0.7, beta=3.0).double()
    source, target = (batch(n, dtype=torch.float64) for n in (50, 40))
    registered = model(source, target)
    ours, theirs = model.encode(source), model.encode(target)
    energy = model.energy(ours, theirs)
    alpha, beta = torch.tensor([[0.7], [3.0]], dtype=torch.float64)
    if model.temperature is not None:
        alpha, beta = model.temperature(source.points, target.points, source.mask, target.mask)
    scores = beta[..., None, None] * (alpha[..., None, None] - energy)
    torch.testing.assert_close(registered.scores, scores)
    m = sinkhorn(registered.scores, rounds=5)
    torch.testing.assert_close(registered.matching, m)
    T = soft_pose(m, source.points, target.points)
    torch.testing.assert_close(registered.T_target_source, T)
    back = sinkhorn(registered.scores.mT, rounds=5)
    torch.testing.assert_close(registered.matching_back, back)
    T_back = soft_pose(back, target.points, source.points)
    torch.testing.assert_close(registered.T_source_target, T_back)


def test_descriptors_can_be_kept() -> None:
    model = build(seed=1)
    source, targets = batch(50), [batch(40, seed=s) for s in (1, 2)]
    kept = model.encode(source)
    for target in targets:
        matching = model.match(source, target, kept, model.encode(target))
        expected = model(source, target).matching
        torch.testing.assert_close(matching, expected, atol=1e-5, rtol=1e-4)


def test_unequal_clouds_in_a_batch_equal_each_pair_alone() -> None:
    model = build(seed=2, temperature="predicted").double()
    sizes = [(60, 40), (45, 52), (30, 30)]
    clouds = [tuple(surface(n, seed=n, dtype=torch.float64) for n in pair) for pair in sizes]
    source, target = (CloudBatch.collate(side) for side in zip(*clouds, strict=True))
    together: Registered = model(source, target)
    for i, (n, m) in enumerate(sizes):
        alone = model(*(CloudBatch.collate([cloud]) for cloud in clouds[i]))
        torch.testing.assert_close(together.matching[i, :n, :m], alone.matching[0])
        torch.testing.assert_close(together.matching[i].sum(), alone.matching.sum())
        torch.testing.assert_close(together.matching_back[i, :m, :n], alone.matching_back[0])
        torch.testing.assert_close(together.T_target_source[i], alone.T_target_source[0])
        torch.testing.assert_close(together.T_source_target[i], alone.T_source_target[0])


def test_swapping_the_clouds_swaps_the_ways() -> None:
    model = build(seed=3).double()
    source, target = (batch(n, dtype=torch.float64) for n in (50, 40))
    there, swapped = model(source, target), model(target, source)
    torch.testing.assert_close(there.matching_back, swapped.matching)
    torch.testing.assert_close(there.T_source_target, swapped.T_target_source)


@pytest.mark.parametrize("angle_deg", [0.0, 1e-3, 90.0, 180.0])
def test_an_untrained_invariant_network_aligns_a_moved_copy(angle_deg: float) -> None:
    """With rotation-invariant input alone, a cloud has the same descriptors in any pose."""
    invariant = {"features": "rri", "rif_only": True}
    model = build(seed=4, **invariant, matching="terms", alpha=1e-3, beta=1e5).double()
    points = surface(80, seed=5, dtype=torch.float64)
    axis = torch.tensor([0.6, -0.3, 0.7], dtype=torch.float64)
    R = rigid.rotation_from_axis_angle(axis, torch.tensor(np.radians(angle_deg)))
    T = rigid.make(R, torch.tensor([0.1, -0.2, 0.3], dtype=torch.float64))
    moved = rigid.apply(T, points)
    registered = model(CloudBatch.collate([points]), CloudBatch.collate([moved]))
    turn = registered.T_target_source[0, :3, :3].detach().mT @ R
    assert float(torch.rad2deg(rigid.rotation_angle_rad(turn))) < 1e-6
    torch.testing.assert_close(
        registered.T_source_target[0].detach(), rigid.invert(T), atol=1e-8, rtol=0
    )


def test_the_way_back_is_computed_once_and_only_when_asked_for() -> None:
    registered = build(seed=6)(batch(40), batch(30))
    assert "matching_back" not in vars(registered)
    assert registered.T_source_target is registered.T_source_target
    assert "matching_back" in vars(registered)


def test_only_a_predicted_temperature_adds_parameters() -> None:
    fixed, predicted = (GMCNet(replace(SMALL, temperature=t)) for t in ("fixed", "predicted"))
    added = {name for name, _ in predicted.named_parameters()}
    added -= {name for name, _ in fixed.named_parameters()}
    assert {name.partition(".")[0] for name in added} == {"temperature"}
