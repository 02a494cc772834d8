"""How far scores are trusted in a pair: by hand, and what may not change."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.pose import confidence
from fullturn.pose.confidence import INPUTS, confidence_inputs, tempered, trusted
from fullturn.pose.verdict import same_pose
from fullturn.pose.verify import EVIDENCE, FEATURES

# Two that are the same pose, a half turn that is the strongest rival, and a quarter turn.
TURNS_DEG = (0.0, 3.0, 180.0, 90.0)
EVIDENCES = (1.0, 2.0, 4.0, -1.0)
P = (0.3, 0.25, 0.35, 0.05, 0.05)


def poses() -> Tensor:
    turns = [torch.tensor([0.0, 0.0, math.radians(turn)]) for turn in TURNS_DEG]
    return rigid.make(rigid.exp_so3(torch.stack(turns).double()), torch.zeros(4, 3).double())


def features(evidence: tuple[float, ...] = EVIDENCES) -> Tensor:
    rows = torch.zeros(len(evidence), len(FEATURES))
    rows[:, FEATURES.index(*EVIDENCE)] = torch.tensor(evidence)
    return rows


def inputs_of(rows: list[int], p: list[float]) -> dict[str, float]:
    T = poses()[rows]
    log_p = torch.tensor(p).double().log()
    found = confidence_inputs(T, features()[rows], same_pose(T, T), log_p)
    return dict(zip(INPUTS, found.tolist(), strict=True))


def test_inputs_by_hand() -> None:
    # The first two together have more than the half turn, and the first one most of it.
    assert inputs_of([0, 1, 2, 3], list(P)) == pytest.approx(
        {
            "rival_turn": 1.0,
            "evidence": 1.0,
            "evidence_below_most": -3.0,
            "evidence_above_rival": -3.0,
            "log_poses": math.log(4),
        }
    )


def test_the_order_of_poses_is_nothing() -> None:
    order = [3, 1, 0, 2]
    shuffled = inputs_of(order, [P[row] for row in order] + [P[-1]])
    expected = inputs_of([0, 1, 2, 3], list(P))
    # Which of two equal ones stands for both may differ.
    for name in ("evidence", "evidence_below_most", "evidence_above_rival"):
        assert abs(shuffled.pop(name) - expected.pop(name)) in (0.0, 1.0)
    assert shuffled == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("rows", [[2], [0, 1]])
def test_without_a_rival_nothing_lies_between(rows: list[int]) -> None:
    found = inputs_of(rows, [0.4] * len(rows) + [0.2])
    assert found["rival_turn"] == pytest.approx(0.0, abs=1e-6)
    assert found["evidence_above_rival"] == 0.0


def test_tempered_by_hand() -> None:
    log_p = torch.tensor([P, P[::-1]]).double().log()
    trust = torch.tensor([[0.5, 1.0], [2.0, 0.0]]).double()
    expected = np.array([np.sqrt(P), np.square(P[::-1])])
    expected[0, -1] *= math.e
    expected /= expected.sum(1, keepdims=True)
    np.testing.assert_allclose(tempered(log_p, trust).exp().numpy(), expected, atol=1e-9)


def test_the_ranking_of_poses_stays() -> None:
    T, log_p = poses(), torch.tensor(P).double().log()
    found = trusted(T, features(), same_pose(T, T), log_p)
    assert float(found.exp().sum()) == pytest.approx(1.0)
    assert found[:-1].argsort().tolist() == log_p[:-1].argsort().tolist()
    assert not torch.allclose(found, log_p)


def test_without_evidence_or_weights_scores_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    T, log_p = poses(), torch.tensor(P).double().log()
    unknown = features((math.nan,) * 4)
    assert torch.equal(trusted(T, unknown, same_pose(T, T), log_p), log_p)
    monkeypatch.setattr(confidence, "load_confidence_net", lambda: None)
    assert torch.equal(trusted(T, features(), same_pose(T, T), log_p), log_p)
