"""Probabilities of poses add up over those that are the same; poses elsewhere are no rivals."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.locating.candidates import grid_of
from fullturn.locating.judge import Judged, judge, same_surface
from fullturn.locating.model import PreparedModel
from fullturn.locating.verify import FEATURES

STAY = (0.0, 0.0, 0.0)


def pose(turn_deg: tuple[float, float, float], shift: tuple[float, float, float]) -> Tensor:
    R = rigid.exp_so3(torch.deg2rad(torch.tensor([turn_deg]).float()))
    return rigid.make(R, torch.tensor([shift]).float())[0]


def judged(
    monkeypatch: pytest.MonkeyPatch,
    box_model: PreparedModel,
    T: list[Tensor],
    p: list[float],
    explained: Tensor | None = None,
) -> Judged:
    """`p` has one more entry than there are poses: none of them."""
    monkeypatch.setattr(
        "fullturn.locating.judge.log_probabilities", lambda *_: torch.tensor(p).double().log()
    )
    if explained is None:
        explained = torch.ones(len(T), 40, dtype=torch.bool)
    features = torch.zeros(len(T), len(FEATURES))
    return judge(torch.stack(T), features, explained, box_model, grid_of(box_model))


def test_a_turn_onto_itself_is_the_same_surface_and_another_pose(
    monkeypatch: pytest.MonkeyPatch, box_model: PreparedModel
) -> None:
    T = [pose(STAY, STAY), pose((0, 0, 180), STAY), pose((1, 0, 0), (0.01, 0, 0))]
    T.append(pose((0, 0, 60), STAY))
    found = judged(monkeypatch, box_model, T, [0.3, 0.25, 0.15, 0.1, 0.2])
    # The third is the pose of the first, and is not listed beside it.
    assert found.index == [0, 1, 3]
    assert found.pose == pytest.approx([0.45, 0.25, 0.1])
    assert found.surface == pytest.approx([0.7, 0.7, 0.1])


def test_poses_that_explain_other_points_are_no_rivals(
    monkeypatch: pytest.MonkeyPatch, box_model: PreparedModel
) -> None:
    explained = torch.zeros(3, 40, dtype=torch.bool)
    explained[0, :20] = explained[1, 20:] = explained[2, 10:] = True
    T = [pose(STAY, STAY), pose(STAY, (3, 0, 0)), pose(STAY, (0.5, 0, 0))]
    found = judged(monkeypatch, box_model, T, [0.4, 0.3, 0.2, 0.1], explained)
    assert found.index == [0, 2]
    assert found.surface == pytest.approx([0.4 / 0.7, 0.2 / 0.7])


def test_nothing_stays_improbable(
    monkeypatch: pytest.MonkeyPatch, box_model: PreparedModel
) -> None:
    found = judged(monkeypatch, box_model, [pose(STAY, STAY)], [0.05, 0.95])
    assert found.surface == pytest.approx([0.05])


def test_the_surface_is_the_same_up_to_a_share_of_the_diameter(box_model: PreparedModel) -> None:
    one = pose((20, 30, 40), (1, 2, 3))[None]
    length = box_model.diameter / box_model.radius
    shifts = [(share * length, 0.0, 0.0) for share in (0.02, 0.2)]
    others = one @ torch.stack([pose(STAY, shift) for shift in shifts])
    same = same_surface(others, one, box_model, grid_of(box_model))
    assert same[:, 0].tolist() == [True, False]


def test_a_limit_scales_all_alike_and_only_down() -> None:
    found = Judged([4, 2], [0.4, 0.2], [0.8, 0.4])
    less = found.at_most(0.2)
    assert less.index == [4, 2]
    assert less.pose == pytest.approx([0.1, 0.05])
    assert less.surface == pytest.approx([0.2, 0.1])
    assert found.at_most(0.9).surface == [0.8, 0.4]
