"""Train the evidence network for `fit_verdict.py`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from fullturn.nn.evidence import EvidenceNet, EvidenceNetConfig
from fullturn.pose.evidence import COMPARED, SIGNALS
from fullturn.pose.verdict import log_shares, standardized
from logit import MISSING, moments

BATCH = 128  # pairs
RATE = 4e-3
HELD_OUT = 1500  # pairs that are looked at on the way
_HIDDEN = 64
_KEPT = 0.7  # share of the points in each step
_AREA = SIGNALS.index("area")


@dataclass(frozen=True, eq=False)
class Signals:
    """The signals of all poses of all pairs, one after the other, on disk."""

    values: np.ndarray  # (poses, 2, m, s), half precision
    first: np.ndarray  # (pairs + 1,): where the poses of a pair begin

    def of(self, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Those of some pairs, and which of these each pose is of."""
        parts = [self.values[self.first[row] : self.first[row + 1]] for row in rows.tolist()]
        pair = torch.repeat_interleave(torch.arange(len(rows)), torch.tensor(list(map(len, parts))))
        return torch.from_numpy(np.concatenate(parts)).float(), pair


def split_signals(
    rows: Iterable[dict[str, Any]], file: Path
) -> tuple[list[dict[str, Any]], Signals]:
    """The rows without their signals, and these in a file, for they outgrow the memory."""
    kept, counts = [], [0]
    one: tuple[int, ...] = ()
    with file.open("wb") as stream:
        for row in rows:
            values = row.pop("signals").numpy()
            stream.write(values.tobytes())
            counts.append(len(values))
            kept.append(row)
            one = values.shape[1:]
    first = np.cumsum(counts)
    return kept, Signals(np.memmap(file, np.float16, "r", shape=(int(first[-1]), *one)), first)


class _Both(nn.Module):
    """The evidence, and a hidden layer over all else that is known of a pose.

    What is known otherwise takes part, so that the network learns what it adds to that.
    """

    def __init__(self, network: EvidenceNet, inputs: int) -> None:
        super().__init__()
        self.network = network
        self.known = nn.Sequential(
            nn.Linear(inputs, _HIDDEN), nn.Tanh(), nn.Linear(_HIDDEN, 1, bias=False)
        )
        self.none = nn.Parameter(torch.zeros(()))

    def forward(self, known: Tensor, present: Tensor, signals: Tensor, pair: Tensor) -> Tensor:
        area = signals[..., _AREA]
        if self.training:
            area = area * (torch.rand_like(area) < _KEPT)
        found = torch.zeros(present.shape)
        found[present] = self.network(signals, area, pair)
        return log_shares(self.known(known)[..., 0] + found, self.none, present)


def fit_evidence(
    signals: Signals,
    inputs: Tensor,
    present: Tensor,
    held_out: Tensor,
    loss: Callable[[Tensor, Tensor], Tensor],
    *,
    width: int,
    steps: int,
    seed: int,
    checkpoint: Path,
) -> EvidenceNet:
    """The network after AdamW on the pairs that are not held out; arguments as `logit.fit_logit`.

    It goes on from the `checkpoint`, where there is one; that of another fit is refused.
    """
    fit = {"width": width, "steps": steps, "seed": seed, "pairs": len(present)}
    torch.manual_seed(seed)
    network = EvidenceNet(EvidenceNetConfig(SIGNALS, COMPARED, width))
    some, _ = signals.of(torch.randperm(len(present))[:200])
    some = some[some[..., _AREA] > 0]
    network.mean.copy_(some.mean(0))
    network.deviation.copy_(some.std(0) + 1e-3)
    standard = standardized(inputs, *moments(inputs, present, held_out)).float()

    both = _Both(network, inputs.shape[-1])
    groups = [
        {"params": [*both.known.parameters(), both.none], "weight_decay": 0.5},
        {"params": both.network.parameters(), "weight_decay": 0.3},
    ]
    optimizer = torch.optim.AdamW(groups, lr=RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    train, test = torch.nonzero(~held_out)[:, 0], torch.nonzero(held_out)[:HELD_OUT, 0]
    stateful: dict[str, Any] = {"both": both, "optimizer": optimizer, "schedule": schedule}
    done = 0
    if checkpoint.exists():
        state = torch.load(checkpoint)
        if state["fit"] != fit:
            raise SystemExit(f"{checkpoint} is of another fit, {state['fit']}; remove it")
        for name, part in stateful.items():
            part.load_state_dict(state[name])
        torch.set_rng_state(state["random"])
        done = state["step"]
    average = 0.0
    for step in range(done + 1, steps + 1):
        rows = train[torch.randint(len(train), (BATCH,))]
        told = standard[rows]
        told = told.masked_fill(torch.rand(len(rows), 1, told.shape[-1]) < MISSING, 0.0)
        value = loss(both(told, present[rows], *signals.of(rows)), rows)
        optimizer.zero_grad()
        value.backward()
        optimizer.step()
        schedule.step()
        average += 0.02 * (value.item() - average)
        if step % 500 == 0:
            both.eval()
            with torch.no_grad():
                losses = [
                    loss(both(standard[part], present[part], *signals.of(part)), part) * len(part)
                    for part in test.split(BATCH)
                ]
            both.train()
            held = sum(losses) / len(test)
            print(f"step {step}: train {average:.3f}, held out {held:.4f}", flush=True)
            state = {name: part.state_dict() for name, part in stateful.items()}
            state |= {"fit": fit, "step": step, "random": torch.get_rng_state()}
            torch.save(state, checkpoint)
    return network.eval()


def evidence_of_all(network: EvidenceNet, signals: Signals) -> Tensor:
    """(poses,): of every pose of every pair."""
    found = []
    with torch.no_grad():
        for rows in torch.arange(len(signals.first) - 1).split(BATCH):
            values, pair = signals.of(rows)
            found.append(network(values, values[..., _AREA], pair))
    return torch.cat(found)
