"""How good the averaged weights are, on shapes that are not trained on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from fullturn.geometry.rigid import rotation_angle_rad
from fullturn.training.batches import PairBatch, make_batch
from fullturn.training.pairs import RunPairs
from fullturn.training.ranks import Ranks

_WORST_DEG = 180.0  # what a pose that isn't finite counts


@dataclass(frozen=True)
class Score:
    """Rotation errors of the validation pairs, summed up."""

    step: int
    pairs: int
    mean_deg: float
    median_deg: float
    below_1: float  # share of the pairs below 1°
    below_5: float


class Validation:
    """The validation pairs, made once; each process keeps and scores its part of them."""

    def __init__(self, pairs: RunPairs, *, count: int, batch: int, ranks: Ranks) -> None:
        self._ranks = ranks
        first, last = (count * k // ranks.size for k in (ranks.rank, ranks.rank + 1))
        own = max(1, batch // ranks.size)
        self._batches = [
            make_batch(pairs, range(at, min(at + own, last))) for at in range(first, last, own)
        ]

    def score(self, model: nn.Module, *, step: int, device: torch.device) -> Score:
        """The score of these weights; the model is in evaluation mode meanwhile."""
        was_training = model.training
        model.eval()
        try:
            with torch.no_grad():
                own = [error for batch in self._batches for error in _errors(model, batch, device)]
        finally:
            model.train(was_training)
        errors = np.array([error for part in self._ranks.gather(own) for error in part])
        return Score(
            step,
            len(errors),
            float(errors.mean()),
            float(np.median(errors)),
            float((errors < 1.0).mean()),
            float((errors < 5.0).mean()),
        )


def _errors(model: nn.Module, batch: PairBatch, device: torch.device) -> Iterator[float]:
    here = batch.to(device)
    found = model(here.source, here.target).T_target_source[:, :3, :3].double()
    true = here.T_target_source[:, :3, :3].double()
    errors = torch.rad2deg(rotation_angle_rad(true.mT @ found))
    yield from errors.nan_to_num(_WORST_DEG).tolist()
