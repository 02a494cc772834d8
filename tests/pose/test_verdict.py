"""Shares between finalists: what must hold for any weights, and the check of the shipped ones."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from pose_shapes import perturbations, pose_error, random_motions
from torch import Tensor

from fullturn.errors import FullturnError
from fullturn.geometry import rigid
from fullturn.geometry.cloud import Cloud
from fullturn.pose import confidence, verdict
from fullturn.pose.verdict import (
    VerdictWeights,
    judge,
    limited,
    load_weights,
    log_probabilities,
    log_rotation_prior,
    same_pose,
    verdict_inputs,
)
from fullturn.pose.verify import FINE

F = 9  # features of the weights made up here


def weights(seed: int = 0, *, features: int = F) -> VerdictWeights:
    rng = np.random.default_rng(seed)

    def draw(*shape: int) -> Tensor:
        return torch.from_numpy(np.asarray(rng.normal(size=shape)))

    width = 3 * features + 6 * FINE
    return VerdictWeights(
        mean=draw(width),
        deviation=draw(width).abs() + 0.5,
        hidden=draw(width, 4),
        hidden_bias=draw(4),
        output=draw(4),
        none=draw(),
    )


@pytest.fixture(autouse=True)
def made_up_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verdict, "load_weights", weights)
    monkeypatch.setattr(confidence, "load_confidence_net", lambda: None)


def rows(count: int, *, seed: int = 0) -> Tensor:
    return torch.from_numpy(np.random.default_rng(seed).normal(size=(count, F)))


def test_inputs_are_the_features_and_how_far_they_lie_from_the_rivals() -> None:
    features = rows(5)
    inputs = verdict_inputs(features)
    torch.testing.assert_close(inputs[:, :F], features)
    torch.testing.assert_close(inputs[:, F : 2 * F], features - features.min(0).values)
    torch.testing.assert_close(inputs[:, 2 * F :], features - features.max(0).values)


def test_small_differences_of_logarithms_are_given_cut_off() -> None:
    features = torch.tensor([[1.0, 5.0], [1.02, 9.0], [1.2, 7.0]]).double()
    cut = verdict_inputs(features, fine=1)[:, 6:].T
    expected = [[0, 0.02, 0.03], [0, 0.02, 0.1], [0, 0.02, 0.2]]
    expected += [[-0.03, -0.03, 0], [-0.1, -0.1, 0], [-0.2, -0.18, 0]]
    torch.testing.assert_close(cut, torch.tensor(expected).double())


def test_absent_finalists_are_as_if_they_were_not_there() -> None:
    features = rows(6)
    present = torch.tensor([True, False, True, True, False, True])
    inputs = verdict_inputs(features, present, fine=FINE)
    alone = verdict_inputs(features[present], fine=FINE)
    torch.testing.assert_close(inputs[present], alone)
    log_p = log_probabilities(inputs, weights(), present).exp()
    expected = log_probabilities(alone, weights()).exp()
    torch.testing.assert_close(log_p[torch.cat([present, torch.tensor([True])])], expected)
    assert float(log_p[:-1][~present].max()) == 0.0


def test_it_is_a_softmax_of_scores_with_none_of_them_last() -> None:
    w, inputs = weights(), verdict_inputs(rows(4), fine=FINE)
    standard = np.clip((inputs.numpy() - w.mean.numpy()) / w.deviation.numpy(), -6, 6)
    score = np.tanh(standard @ w.hidden.numpy() + w.hidden_bias.numpy()) @ w.output.numpy()
    exponent = np.exp(np.append(score, float(w.none)))
    np.testing.assert_allclose(
        log_probabilities(inputs, w).exp().numpy(), exponent / exponent.sum(), atol=1e-12
    )


def test_a_batch_equals_the_loop_and_the_order_is_nothing() -> None:
    features = torch.stack([rows(5, seed=seed) for seed in range(3)])
    batch = log_probabilities(verdict_inputs(features, fine=FINE), weights())
    assert batch.shape == (3, 6)
    torch.testing.assert_close(batch.exp().sum(-1), torch.ones(3).double())
    order = torch.tensor([3, 0, 4, 1, 2])
    for one, many in zip(features, batch, strict=True):
        torch.testing.assert_close(
            log_probabilities(verdict_inputs(one, fine=FINE), weights()), many
        )
        mixed = log_probabilities(verdict_inputs(one[order], fine=FINE), weights())
        torch.testing.assert_close(mixed[:-1], many[:-1][order])


def test_same_pose_by_hand() -> None:
    T = random_motions(4, seed=1)
    near = torch.cat(
        [
            T @ perturbations(4, seed=2, angle_deg=angle, length=length)
            for angle, length in ((4.9, 0.04), (5.1, 0.04), (4.9, 0.06), (179.0, 0.0))
        ]
    )
    found = same_pose(T, near)
    for i, j in np.ndindex(*found.shape):
        angle, offset = pose_error(near[j], T[i])
        assert bool(found[i, j]) == (float(angle) < 5.0 and float(offset) < 0.05)
    assert found.sum().item() == 4


@pytest.mark.parametrize("count", [1, 2, 40])
def test_judged_poses_are_distinct_ranked_and_share_at_most_one(count: int) -> None:
    # Three clusters of poses, looser than the tolerance.
    centers = random_motions(3, seed=3)[torch.arange(count) % 3]
    T = centers @ perturbations(count, seed=4, angle_deg=4.0, length=0.03)
    judged = judge(T, rows(count))
    assert len(judged.index) == len(judged.probability) >= min(count, 3)
    assert sum(judged.probability) <= 1.0
    assert min(judged.probability) >= 0.0
    assert judged.probability == sorted(judged.probability, reverse=True)
    listed = T[judged.index]
    assert bool((same_pose(listed, listed) == torch.eye(len(listed), dtype=torch.bool)).all())
    # Every finalist is listed or close to one that is.
    assert bool(same_pose(T, listed).any(1).all())


def test_equal_features_get_equal_shares() -> None:
    T = random_motions(4, seed=5)
    judged = judge(T, rows(1).expand(4, F))
    assert judged.probability == pytest.approx([judged.probability[0]] * 4)
    log_p = log_probabilities(verdict_inputs(rows(1).expand(4, F), fine=FINE), weights())
    assert judged.probability[0] == pytest.approx(math.exp(float(log_p[0])))


def test_finalists_within_the_tolerance_speak_for_one_pose() -> None:
    pose, far = random_motions(2, seed=6)
    near = pose @ rigid.exp_se3(torch.tensor([0.02, 0, 0, 0.01, 0, 0]).double())
    features = rows(3)
    judged = judge(torch.stack([pose, far, near]), features)
    shares = log_probabilities(verdict_inputs(features, fine=FINE), weights()).exp()
    by_index = dict(zip(judged.index, judged.probability, strict=True))
    assert len(by_index) == 2
    assert by_index[1] == pytest.approx(float(shares[1]))
    (together,) = (by_index[i] for i in (0, 2) if i in by_index)
    assert together == pytest.approx(float(shares[0] + shares[2]))


def test_a_tiny_limit_is_one_like_others() -> None:
    T = torch.eye(4).double()[None]
    for limit_rad in (1e-9, 1e-4, 2e-3):
        log_ratio = float(log_rotation_prior(T, limit_rad))
        # (1/L) / ((θ²/2) / (L³/6)) at θ = L/10
        assert log_ratio == pytest.approx(math.log(100 / 3), rel=1e-4)


@pytest.mark.parametrize("limit_deg", [5.0, 60.0, 179.0])
def test_the_prior_is_a_ratio_of_two_densities(limit_deg: float) -> None:
    limit = math.radians(limit_deg)
    angles = torch.linspace(0, limit, 20_001).double()
    T = torch.eye(4).double().repeat(len(angles), 1, 1)
    T[:, :3, :3] = rigid.exp_so3(angles[:, None] * torch.tensor([[0.0, 0.6, 0.8]]))
    of_wrong = (1 - angles.cos()) / (limit - math.sin(limit))
    of_truth = log_rotation_prior(T, limit).exp() * of_wrong
    above = angles > 0.11 * limit
    torch.testing.assert_close(of_truth[above], torch.full_like(of_truth[above], 1 / limit))
    # What is cut off at small angles is little.
    assert float(torch.trapezoid(of_truth, angles)) == pytest.approx(1.0, abs=0.08)


def test_poses_beyond_a_limit_count_as_at_the_limit() -> None:
    T = torch.eye(4).double().repeat(2, 1, 1)
    T[:, :3, :3] = rigid.exp_so3(torch.tensor([[0.002, 0.0, 0.0], [0.05, 0.0, 0.0]]).double())
    at, beyond = log_rotation_prior(T, 0.002).tolist()
    assert at == pytest.approx(math.log(1 / 3), abs=1e-3)
    assert beyond == pytest.approx(at)


def test_among_equals_a_known_limit_prefers_the_smaller_turn() -> None:
    turns = torch.tensor([[1.0, 0, 0], [0, 0.5, 0], [0, 0, 1.2]]).double()
    T = torch.eye(4).double().repeat(3, 1, 1)
    T[:, :3, :3] = rigid.exp_so3(turns)
    features = rows(1).expand(3, F)
    assert judge(T, features, max_rotation_rad=1.5).index == [1, 0, 2]
    free = judge(T, features)
    assert free.probability == pytest.approx([free.probability[0]] * 3)


def test_single_precision_features_are_judged_in_double() -> None:
    T, features = random_motions(6, seed=7), rows(6)
    precise, coarse = judge(T, features), judge(T, features.float())
    assert coarse.index == precise.index
    assert coarse.probability == pytest.approx(precise.probability, abs=1e-5)


def test_doubt_is_of_the_scores_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    T, features = random_motions(6, seed=7), rows(6)
    plain = judge(T, features)

    def surer_of_none(*told: Tensor) -> Tensor:
        return (told[-1] + torch.eye(7)[-1]).log_softmax(-1)

    monkeypatch.setattr(verdict, "trusted", surer_of_none)
    trusted = judge(T, features)
    assert trusted.doubt == plain.doubt
    assert trusted.index == plain.index
    assert sum(trusted.probability) < sum(plain.probability)


def test_the_shipped_weights_fit_the_features() -> None:
    from fullturn.pose.verify import FEATURES

    shipped = load_weights()
    inputs = 3 * len(FEATURES) + 6 * FINE
    assert shipped.mean.shape == shipped.deviation.shape == (inputs,)
    assert shipped.hidden.shape[0] == inputs
    assert shipped.hidden.shape[1:] == shipped.hidden_bias.shape == shipped.output.shape
    assert shipped.none.shape == ()
    for value in vars(shipped).values():
        assert value.dtype == torch.float64
        assert bool(torch.isfinite(value).all())
    assert float(shipped.deviation.min()) > 0.0


@pytest.mark.parametrize("name", ["verdict", "locate"])
def test_weights_for_other_features_are_refused(name: str) -> None:
    with pytest.raises(FullturnError, match=rf"expected weights fit to the 2 .*fit_{name}.py"):
        load_weights(f"{name}.safetensors", ("distance", "gravity"))


def test_a_cloud_of_copies_has_the_size_of_what_they_are_copies_of() -> None:
    ends = torch.tensor([-1.0, 1.0])
    corners = torch.cat(
        [torch.eye(3), -torch.eye(3), torch.cartesian_prod(ends, ends, ends) / 3**0.5]
    )
    corners = corners.double()
    crowded = Cloud(torch.cat([corners, torch.zeros(1000, 3).double()]))
    probability = torch.tensor([0.6, 0.3]).double()
    for pair in ((crowded, Cloud(corners.repeat(3, 1))), (Cloud(corners.repeat(3, 1)), crowded)):
        found, notes = limited(probability, *pair)
        assert not notes
        torch.testing.assert_close(found, probability)
    found, notes = limited(probability, crowded, Cloud(100 * corners.repeat(3, 1)))
    assert "times as large" in notes[0]
    assert float(found.sum()) == pytest.approx(0.2)


def test_copies_of_a_few_points_are_few_points() -> None:
    few = Cloud(torch.eye(3).double().repeat(20, 1))
    found, notes = limited(torch.tensor([0.9]).double(), few, few)
    assert "fewer than 12 points" in notes[0]
    assert float(found.sum()) == pytest.approx(0.2)


def test_copies_that_come_first_hide_none_of_the_others() -> None:
    points = torch.randn(2000, 3, generator=torch.Generator().manual_seed(0)).double()
    cloud = Cloud(torch.cat([torch.zeros(90, 3).double(), points]))  # missing returns
    stated = torch.tensor([0.9]).double()
    found, notes = limited(stated, cloud, cloud)
    assert notes == ()
    assert torch.equal(found, stated)


@pytest.mark.parametrize("limit_rad", [1e-120, 1e-300])
def test_the_smallest_limits_have_a_prior(limit_rad: float) -> None:
    prior = log_rotation_prior(torch.eye(4).double()[None], limit_rad)
    assert bool(torch.isfinite(prior).all())
