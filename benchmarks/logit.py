"""Collect rows in files, and fit a conditional logit over poses: what the fits share."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fullturn.errors import FullturnError
from fullturn.pose.verdict import VerdictWeights, log_probabilities

BATCH = 512
RATE = 5e-3
MISSING = 0.1  # share of the inputs, in each step of the fit: none is to be relied on alone


def held_out_rows(shape: np.ndarray, rng: np.random.Generator) -> Tensor:
    """Which rows show one of the fifth of the shapes that the fit must not see."""
    shapes = np.unique(shape)
    return torch.from_numpy(np.isin(shape, rng.choice(shapes, len(shapes) // 5, replace=False)))


def read_rows(folder: Path) -> Iterator[dict[str, Any]]:
    """All that was collected, in the order of the files' names."""
    files = sorted(folder.glob("*.pt"))
    if not files:
        raise SystemExit(f"expected collected rows in {folder}; run the step `collect` first")
    for file in files:
        yield from torch.load(file, weights_only=False)


def collect_shards(
    args: argparse.Namespace, stem: str, rows_of: Callable[[int], Iterable[dict[str, Any]]]
) -> None:
    """Write the rows of the numbers from `first` to `count`, `shard` of them a file.

    Files that are there stay; a number that can't be made is named and left out.
    """
    torch.set_num_threads(1)
    args.out.mkdir(parents=True, exist_ok=True)
    for first in range(args.first, args.count, args.shard):
        path = args.out / f"{stem}-{first:06d}.pt"
        if path.exists():
            continue
        rows: list[dict[str, Any]] = []
        for number in range(first, min(first + args.shard, args.count)):
            try:
                rows += rows_of(number)
            except FullturnError as error:
                print(number, type(error).__name__, error, flush=True)
        torch.save(rows, path)
        print(path.name, len(rows), flush=True)


def moments(inputs: Tensor, present: Tensor, held_out: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation of each input over what is present and not held out."""
    known = inputs[~held_out][present[~held_out]]
    mean = known.nanmean(0)
    return mean, (known - mean).square().nanmean(0).sqrt() + 1e-6


def fit_logit(
    inputs: Tensor,
    present: Tensor,
    held_out: Tensor,
    loss: Callable[[Tensor, Tensor], Tensor],
    *,
    hidden: int,
    steps: int,
    weight_decay: float,
    seed: int,
) -> VerdictWeights:
    """The weights after AdamW on the rows that are not held out.

    `inputs` (n, k, g), NaN where something could not be measured; `present` (n, k). The `loss` is
    the mean over rows, of their log probabilities (m, k + 1) and their numbers (m,).
    """
    mean, deviation = moments(inputs, present, held_out)
    generator = torch.Generator().manual_seed(seed)
    width = inputs.shape[-1]
    drawn = torch.randn(width, hidden, generator=generator, dtype=torch.float64)
    parameters = [
        (drawn / width**0.5).requires_grad_(),
        torch.zeros(hidden, dtype=torch.float64, requires_grad=True),
        torch.zeros(hidden, dtype=torch.float64, requires_grad=True),
        torch.zeros((), dtype=torch.float64, requires_grad=True),
    ]

    def loss_of(rows: Tensor, told: Tensor) -> Tensor:
        weights = VerdictWeights(mean, deviation, *parameters)
        return loss(log_probabilities(told, weights, present[rows]), rows)

    train, test = torch.nonzero(~held_out)[:, 0], torch.nonzero(held_out)[:, 0]
    optimizer = torch.optim.AdamW(parameters, lr=RATE, weight_decay=weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for step in range(steps):
        rows = train[torch.randperm(len(train), generator=generator)[:BATCH]]
        missing = torch.rand(len(rows), 1, width, generator=generator) < MISSING
        optimizer.zero_grad()
        value = loss_of(rows, inputs[rows].masked_fill(missing, torch.nan))
        value.backward()
        optimizer.step()
        schedule.step()
        if step % 200 == 0:
            with torch.no_grad():
                other = loss_of(test, inputs[test])
            print(f"step {step}: train {value.item():.3f}, held out {other.item():.3f}", flush=True)
    return VerdictWeights(mean, deviation, *(p.detach() for p in parameters))


def steps_parser(
    doc: str | None,
    name: str,
    *,
    collected: str,
    count: int,
    shard: int,
    seed: int,
    steps: Iterable[str] = ("collect", "fit"),
) -> argparse.ArgumentParser:
    """The options of a script that collects what it then fits NAME.safetensors to.

    `collected` names what is counted, as in "pairs".
    """
    parser = argparse.ArgumentParser(description=(doc or "").split("\n")[0])
    parser.add_argument("step", choices=list(steps))
    parser.add_argument("--out", type=Path, default=Path("runs") / name, help="what is collected")
    parser.add_argument("--count", type=int, default=count, help=f"{collected} to collect")
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--shard", type=int, default=shard, help=f"{collected} a file")
    parser.add_argument("--seed", type=int, default=seed)
    parser.add_argument("--data", default=os.environ.get("FULLTURN_DATA"), help="mesh packs")
    parser.add_argument("--hidden", type=int)
    parser.add_argument("--steps", type=int)
    parser.add_argument("--weight-decay", type=float)
    weights = Path("src/fullturn/weights") / f"{name}.safetensors"
    parser.add_argument("--weights", type=Path, default=weights)
    return parser
