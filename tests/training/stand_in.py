"""A model that learns something at once, for tests of what is around the network."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from fullturn.geometry import rigid
from fullturn.nn.clouds import CloudBatch
from fullturn.training.config import TrainConfig
from fullturn.training.objective import Objective


@dataclass(frozen=True, eq=False)
class Guess:
    """A pose for each pair."""

    T_target_source: Tensor


class StandIn(nn.Module):
    """Guesses a twist from both clouds' mean features.

    With dropout, so that seeds matter, and a buffer that each forward pass in training moves.
    """

    steps: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.features = nn.Sequential(nn.Linear(3, 8), nn.Tanh())
        self.dropout = nn.Dropout(0.2)
        self.twist = nn.Linear(16, 6)
        self.register_buffer("steps", torch.zeros(()))

    def forward(self, source: CloudBatch, target: CloudBatch) -> Guess:
        if self.training:
            self.steps += 1
        pooled = [(self.features(c.points) * c.mask[..., None]).mean(1) for c in (source, target)]
        return Guess(rigid.exp_se3(self.twist(self.dropout(torch.cat(pooled, -1)))))


def squared(answer: Guess, source: CloudBatch, target: CloudBatch, T_true: Tensor) -> Tensor:
    return (answer.T_target_source - T_true).square().sum((-1, -2)).mean()


def stand_in(config: TrainConfig) -> Objective:
    """The stand-in with the squared difference of the poses."""
    return Objective(lambda recipe: StandIn(), {"squared": (1.0, squared)})


class Diary:
    """A watcher that remembers what it was told."""

    def __init__(self) -> None:
        self.losses: dict[int, float] = {}
        self.scored: list[int] = []

    def start(self, step: int, *, total: int | None) -> None:
        self.total = total

    def step(self, step: int, *, loss: float, seconds: float, pairs: int) -> None:
        self.losses[step] = loss

    def score(self, score: object, *, is_best: bool) -> None:
        self.scored.append(score.step)  # type: ignore[attr-defined]


RECIPE = """
[data]
shapes = [{ path = "procedural:12:3" }]
batch = 4
sample_points = 64
cloud_points = 48
[loss]
paper = 1.0
[optimizer]
rate = 1e-2
ema = 0.9
[budget]
steps = 6
[validation]
every = 3
pairs = 4
share = 0.2
[machine]
device = "cpu"
checkpoint_every = 2
"""
