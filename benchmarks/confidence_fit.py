"""Train the confidence network for `fit_verdict.py`."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from fullturn.nn.confidence import ConfidenceNet, ConfidenceNetConfig
from fullturn.pose.confidence import INPUTS, tempered

BATCH = 512  # pairs
RATE = 3e-3
DECAY = 0.1


def fit_confidence(
    inputs: Tensor,
    log_p: Tensor,
    held_out: Tensor,
    answer: tuple[Tensor, Tensor],
    loss: Callable[[Tensor, Tensor], Tensor],
    *,
    steps: int,
    seed: int,
) -> ConfidenceNet:
    """The network after AdamW on the rows that are not held out.

    `inputs` (n, i) and `log_p` (n, k + 1) of all pairs; `answer` says which finalists (n, k) the
    answer's probability is the sum of, and whether it is right (n,). Beside the verdict's `loss`
    counts the cross entropy of that one probability, for it is what users go by.
    """
    chosen, right = answer[0].double(), answer[1].double()
    train, test = torch.nonzero(~held_out)[:, 0], torch.nonzero(held_out)[:, 0]
    generator = torch.Generator().manual_seed(seed)
    torch.manual_seed(seed)
    network = ConfidenceNet(ConfidenceNetConfig(INPUTS))
    deviation, mean = torch.std_mean(inputs[train], 0)
    network.mean.copy_(mean)
    network.deviation.copy_(deviation + 1e-6)
    optimizer = torch.optim.AdamW(network.parameters(), lr=RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)

    def value_of(rows: Tensor) -> Tensor:
        stated = tempered(log_p[rows], network(inputs[rows].float()).double())
        share = (stated[:, :-1].exp() * chosen[rows]).sum(1).clamp(1e-4, 1 - 1e-4)
        return loss(stated, rows) + torch.nn.functional.binary_cross_entropy(share, right[rows])

    for step in range(steps):
        rows = train[torch.randperm(len(train), generator=generator)[:BATCH]]
        optimizer.zero_grad()
        value = value_of(rows)
        value.backward()
        optimizer.step()
        schedule.step()
        if step % 200 == 0:
            with torch.no_grad():
                other = value_of(test)
            print(f"step {step}: train {value.item():.3f}, held out {other.item():.3f}", flush=True)
    return network.eval()
