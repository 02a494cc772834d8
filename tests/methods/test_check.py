"""Answers that are none are refused by name; good ones come back in float64."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from fullturn.errors import InputError
from fullturn.methods.base import Estimate
from fullturn.methods.check import checked_estimate

EYE = torch.eye(4, dtype=torch.float64)


def pose(**entries: float) -> torch.Tensor:
    T = EYE.clone()[None]
    for place, value in entries.items():
        T[0, int(place[1]), int(place[2])] = value
    return T


def test_float32_poses_pass_and_become_float64() -> None:
    R = torch.from_numpy(Rotation.random(50, rng=np.random.default_rng(0)).as_matrix())
    T = EYE.repeat(50, 1, 1)
    T[:, :3, :3] = R
    checked = checked_estimate(Estimate(T.float()), "mine")
    assert checked.T_target_source.dtype == torch.float64
    assert checked.success_probability is None
    given = Estimate(T[:2], torch.tensor([0.75, 0.25]), None, {"a": 1.0})
    checked = checked_estimate(given, "mine")
    assert checked.success_probability is not None
    assert checked.success_probability.tolist() == [0.75, 0.25]
    assert checked.seconds == {"a": 1.0}


def test_an_answer_of_a_network_leaves_its_gradients_behind() -> None:
    given = Estimate(EYE[None].clone().requires_grad_(), torch.tensor([0.5], requires_grad=True))
    checked = checked_estimate(given, "mine")
    assert checked.success_probability is not None
    assert not checked.T_target_source.requires_grad
    assert not checked.success_probability.requires_grad


@pytest.mark.parametrize(
    ("estimate", "message"),
    [
        (None, "expected an Estimate from estimate.., got a NoneType"),
        (EYE, "got a Tensor"),
        (Estimate(EYE), r"shape \(k, 4, 4\) with k of at least 1, got shape \(4, 4\)"),
        (Estimate(EYE[None][:0]), r"got shape \(0, 4, 4\)"),
        (Estimate(np.eye(4)[None]), "got a ndarray"),  # type: ignore[arg-type]
        (Estimate(pose(T00=1.01)), "expected rigid poses"),
        (Estimate(pose(T00=-1.0)), "expected rigid poses"),
        (Estimate(pose(T03=np.nan)), "expected rigid poses"),
        (Estimate(pose(T03=np.inf)), "expected rigid poses"),
        (Estimate(pose(T11=np.nan)), "expected rigid poses"),
        (Estimate(pose(T30=1.0)), "expected rigid poses"),
        (Estimate(EYE[None], torch.ones(2)), r"each of the 1 poses, or None, got shape \(2,\)"),
        (Estimate(EYE[None], 0.5), "got a float"),  # type: ignore[arg-type]
        (Estimate(EYE[None], torch.tensor([-0.1])), "from 0 that sum to at most 1, got -0.1"),
        (Estimate(EYE[None], torch.tensor([1.1])), "sum to at most 1, got 1.1"),
        (Estimate(EYE[None], torch.tensor([np.nan])), "sum to at most 1, got nan"),
        (Estimate(EYE.repeat(2, 1, 1), torch.tensor([0.25, 0.5])), "first, .* of 0.25 0.5; sort"),
    ],
)
def test_what_is_no_answer_is_named(estimate: Any, message: str, unchecked: None) -> None:
    with pytest.raises(InputError, match=f"^method mine: .*{message}"):
        checked_estimate(estimate, "mine")
