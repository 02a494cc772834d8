"""Averaged weights: what is validated and exported."""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn


class WeightAverage:
    """An exponential moving average of a model's parameters and floating-point buffers.

    a ← d·a + (1 − d)·w with d = min(decay, (1 + k)/(10 + k)) in step k, so that the first weights
    are soon forgotten. With a decay of 0, the average is the model itself, without a copy.
    """

    def __init__(self, model: nn.Module, *, decay: float) -> None:
        self.model = copy.deepcopy(model).requires_grad_(False) if decay > 0.0 else model
        self._decay, self._source = decay, model

    @torch.no_grad()
    def update(self, step: int) -> None:
        """Take in the weights after step `step`, counted from 1."""
        if self._decay <= 0.0:
            return
        weight = 1.0 - min(self._decay, (1.0 + step) / (10.0 + step))
        averaged, current = _floats(self.model), _floats(self._source)
        torch._foreach_lerp_(averaged, current, weight)
        for old, new in zip(self.model.buffers(), self._source.buffers(), strict=True):
            if not old.is_floating_point():
                old.copy_(new)


def _floats(model: nn.Module) -> list[Tensor]:
    buffers = [buffer for buffer in model.buffers() if buffer.is_floating_point()]
    return [*(parameter.data for parameter in model.parameters()), *buffers]
