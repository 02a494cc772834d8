"""The learning rate of a step."""

from __future__ import annotations

import math

from fullturn.training.config import OptimizerConfig


def learning_rate(step: int, config: OptimizerConfig, *, total: int | None) -> float:
    """The rate of step `step` (from 0) of `total`, after a linear warmup.

    Linear or cosine from ``rate`` down to ``final_share · rate`` at the last step; None: no end is
    known, and the schedule is constant.

    >>> [learning_rate(k, OptimizerConfig(rate=1.0, final_share=0.0), total=5) for k in (0, 2, 4)]
    [1.0, 0.5, 0.0]
    """
    if step < config.warmup_steps:
        return config.rate * (step + 1) / (config.warmup_steps + 1)
    if config.schedule == "constant" or total is None:
        return config.rate
    length = max(total - 1 - config.warmup_steps, 1)
    done = min((step - config.warmup_steps) / length, 1.0)
    left = 1.0 - done if config.schedule == "linear" else 0.5 * (1.0 + math.cos(math.pi * done))
    return config.rate * (config.final_share + (1.0 - config.final_share) * left)
