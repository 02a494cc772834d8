"""Losses agree with their formulas as loops, ignore padding, and fall towards the truth."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.matching.sinkhorn import sinkhorn
from fullturn.methods.learned.gmcnet import Registered
from fullturn.nn.clouds import CloudBatch
from fullturn.pose.soft import soft_pose
from fullturn.training.losses import correspondence_loss, paper_loss

SIZES = [(7, 5), (4, 9)]


def poses(count: int, *, seed: int) -> Tensor:
    rng = np.random.default_rng(seed)
    return rigid.make(
        rigid.random_rotations_uniform(count, rng=rng),
        torch.from_numpy(rng.normal(size=(count, 3))),
    )


def pairs(*, seed: int = 0, sizes: list[tuple[int, int]] = SIZES) -> tuple[CloudBatch, CloudBatch]:
    rng = np.random.default_rng(seed)
    sides = zip(*sizes, strict=True)
    source, target = (
        CloudBatch.collate([torch.from_numpy(rng.normal(size=(n, 3))) for n in side])
        for side in sides
    )
    return source, target


def registered_from(scores: Tensor, source: CloudBatch, target: CloudBatch) -> Registered:
    matching = sinkhorn(scores, source.mask, target.mask)
    T = soft_pose(matching, source.points, target.points)
    return Registered(T, matching, scores, source, target, 5)


def random_answer(source: CloudBatch, target: CloudBatch, *, seed: int = 1) -> Registered:
    shape = (*source.mask.shape, target.mask.shape[1])
    scores = torch.from_numpy(np.random.default_rng(seed).normal(size=shape))
    return registered_from(scores.requires_grad_(), source, target)


def one_way(T: Tensor, T_true: Tensor, matching: Tensor, points: Tensor, omega: float) -> float:
    """G9 in one direction for one pair without padding."""
    n, m = matching.shape
    L_reg = 0.0
    for x in points:
        a, b = T[:3, :3] @ x + T[:3, 3], T_true[:3, :3] @ x + T_true[:3, 3]
        L_reg += sum(abs(float(d)) for d in (a - b).detach()) / (3 * n)
    rows = sum(1.0 - float(matching[i].detach().sum()) for i in range(n)) / n
    columns = sum(1.0 - float(matching[:, j].detach().sum()) for j in range(m)) / m
    return L_reg + omega * (columns + rows)


@pytest.mark.parametrize("cycle", [False, True])
def test_paper_loss_by_loops(cycle: bool) -> None:
    source, target = pairs()
    T_true = poses(2, seed=2)
    answer = random_answer(source, target)
    expected = 0.0
    for i, (n, m) in enumerate(SIZES):
        x, y = source.points[i, :n], target.points[i, :m]
        matching = answer.matching[i, :n, :m]
        expected += one_way(answer.T_target_source[i], T_true[i], matching, x, 0.3) / 2
        if cycle:
            T_back = torch.linalg.inv(T_true[i])
            matching = answer.matching_back[i, :m, :n]
            expected += one_way(answer.T_source_target[i], T_back, matching, y, 0.3) / 2
    loss = paper_loss(answer, source, target, T_true, cycle=cycle, inlier_weight=0.3)
    assert float(loss.detach()) == pytest.approx(expected, rel=1e-10)


def test_correspondence_loss_by_loops() -> None:
    source, target = pairs(seed=3)
    T_true = poses(2, seed=4)
    answer = random_answer(source, target)
    radius, expected, outcomes = 1.0, 0.0, set()
    for i, (n, m) in enumerate(SIZES):
        x = rigid.apply(T_true[i], source.points[i, :n])
        y = target.points[i, :m]
        scores = answer.scores[i, :n, :m].detach()
        for rows, here, there in ((scores, x, y), (scores.T, y, x)):
            for row, point in zip(rows, here, strict=True):
                distance = [float((point - other).norm()) for other in there]
                j = int(np.argmin(distance))
                logit = float(row[j]) if distance[j] <= radius else 0.0
                outcomes.add(distance[j] <= radius)
                total = 1.0 + sum(math.exp(float(s)) for s in row)
                expected += (math.log(total) - logit) / len(here) / 4
    loss = correspondence_loss(answer, source, target, T_true, radius=radius)
    assert outcomes == {True, False}
    assert float(loss.detach()) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("kind", ["paper", "cycle", "correspondence"])
def test_padding_gets_no_gradient_and_changes_nothing(kind: str) -> None:
    source, target = pairs(seed=5)
    T_true = poses(2, seed=6)
    # Padding where a partner would be.
    moved = rigid.apply(T_true, source.points)
    target.points[0, SIZES[0][1] :] = moved[0, 0]

    def loss_of(answer: Registered, x: CloudBatch, y: CloudBatch, T: Tensor) -> Tensor:
        if kind == "correspondence":
            return correspondence_loss(answer, x, y, T, radius=1.0)
        return paper_loss(answer, x, y, T, cycle=kind == "cycle")

    answer = random_answer(source, target)
    together = loss_of(answer, source, target, T_true)
    together.backward()
    gradient = answer.scores.grad
    assert gradient is not None
    apart = 0.0
    for i, (n, m) in enumerate(SIZES):
        x = CloudBatch.collate([source.points[i, :n]])
        y = CloudBatch.collate([target.points[i, :m]])
        scores = answer.scores[i : i + 1, :n, :m].detach().requires_grad_()
        alone = loss_of(registered_from(scores, x, y), x, y, T_true[i : i + 1])
        alone.backward()
        apart += float(alone.detach()) / 2
        assert scores.grad is not None
        torch.testing.assert_close(gradient[i, :n, :m], scores.grad[0] / 2)
        assert float(gradient[i].abs().sum()) == pytest.approx(float(scores.grad.abs().sum()) / 2)
    assert float(together.detach()) == pytest.approx(apart)


def perfect(sharpness: float) -> tuple[Registered, CloudBatch, CloudBatch, Tensor]:
    T_true = poses(3, seed=7)
    rng = np.random.default_rng(8)
    points = torch.from_numpy(rng.normal(size=(3, 20, 3)))
    source = CloudBatch.collate(list(points))
    target = CloudBatch.collate(list(rigid.apply(T_true, points)))
    scores = sharpness * (2.0 * torch.eye(20).double() - 1.0).expand(3, 20, 20)
    return registered_from(scores, source, target), source, target, T_true


def test_the_right_answer_costs_what_the_slack_keeps() -> None:
    answer, source, target, T_true = perfect(60.0)
    exact = paper_loss(answer, source, target, T_true, cycle=True)
    # Five rounds leave 1/6 of each row and of each column to the slack.
    assert float(exact) == pytest.approx(0.01 * 2 * (1 / 6 + 1 / 6), abs=1e-9)
    wrong = paper_loss(answer, source, target, poses(3, seed=9), cycle=True)
    assert float(wrong) > 0.5
    right = correspondence_loss(answer, source, target, T_true, radius=0.01)
    assert float(right) == pytest.approx(0.0, abs=1e-12)
    no_partner = correspondence_loss(answer, source, target, poses(3, seed=9), radius=1e-6)
    assert float(no_partner) == pytest.approx(60.0, rel=1e-6)


def test_without_the_cycle_the_way_back_is_not_computed() -> None:
    source, target = pairs(seed=10)
    answer = random_answer(source, target)
    paper_loss(answer, source, target, poses(2, seed=11), cycle=False)
    assert "matching_back" not in vars(answer)


@pytest.mark.parametrize("kind", ["paper", "correspondence"])
def test_descent_on_the_scores_finds_the_pose(kind: str) -> None:
    _, source, target, T_true = perfect(1.0)
    rng = np.random.default_rng(12)
    scores = torch.from_numpy(rng.normal(scale=0.1, size=(3, 20, 20))).requires_grad_()
    optimizer = torch.optim.Adam([scores], lr=0.3)
    for _ in range(60):
        optimizer.zero_grad()
        answer = registered_from(scores, source, target)
        if kind == "paper":
            loss = paper_loss(answer, source, target, T_true, cycle=True)
        else:
            loss = correspondence_loss(answer, source, target, T_true, radius=0.1)
        loss.backward()
        optimizer.step()
    answer = registered_from(scores, source, target)
    turn = answer.T_target_source[:, :3, :3].detach().mT @ T_true[:, :3, :3]
    assert float(torch.rad2deg(rigid.rotation_angle_rad(turn)).max()) < 5.0


@pytest.mark.parametrize("case", ["all alike", "hopeless"])
def test_gradients_stay_finite_where_nothing_is_known(case: str) -> None:
    source, target = pairs(seed=13)
    source, target = source.to(torch.float32), target.to(torch.float32)
    level = {"all alike": 0.0, "hopeless": -200.0}[case]
    scores = torch.full((2, 7, 9), level, requires_grad=True)
    answer = registered_from(scores, source, target)
    T_true = poses(2, seed=14)
    loss = paper_loss(answer, source, target, T_true, cycle=True)
    loss = loss + correspondence_loss(answer, source, target, T_true, radius=0.5)
    loss.backward()
    assert scores.grad is not None
    assert bool(torch.isfinite(scores.grad).all())
