"""Batches of pairs, made on the fly: here, or ahead of time in worker processes."""

from __future__ import annotations

import itertools
import signal
from collections.abc import Generator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils.data import DataLoader

from fullturn.nn.clouds import CloudBatch
from fullturn.training.pairs import RunPairs

_AHEAD = 4  # batches that each worker keeps ready


@dataclass(frozen=True, eq=False)
class PairBatch:
    """Pairs of a step, in single precision."""

    source: CloudBatch
    target: CloudBatch
    T_target_source: Float[Tensor, "b 4 4"]
    numbers: tuple[int, ...]  # of the pairs in the run

    def to(self, device: torch.device) -> PairBatch:
        """The same pairs on a device."""
        return PairBatch(
            self.source.to(device),
            self.target.to(device),
            self.T_target_source.to(device),
            self.numbers,
        )


def make_batch(pairs: RunPairs, numbers: range) -> PairBatch:
    """The pairs with these numbers."""
    made = [pairs.pair(number) for number in numbers]
    sides = ([p.source for p in made], [p.target for p in made])
    source, target = (
        CloudBatch.collate([torch.from_numpy(cloud).float() for cloud in side]) for side in sides
    )
    poses = torch.stack([torch.from_numpy(pair.T_target_source) for pair in made])
    return PairBatch(source, target, poses.float(), tuple(numbers))


@dataclass(frozen=True)
class Steps:
    """Batches by the number of the step: `rank`'s part of each, where `size` processes share it."""

    pairs: RunPairs
    batch: int  # pairs of a step, over all processes
    rank: int = 0
    size: int = 1

    def __getitem__(self, step: int) -> PairBatch:
        own = self.batch // self.size
        first = step * self.batch + self.rank * own
        return make_batch(self.pairs, range(first, first + own))


def stream(steps: Steps, *, first: int, workers: int) -> Generator[PairBatch, None, None]:
    """The batches of the steps from `first` on, the same for any number of `workers`."""
    if workers == 0:
        for step in itertools.count(first):
            yield steps[step]
    # Pairs for a GPU of many thousand pairs a second would be made here, on the device, by number.
    yield from DataLoader(
        steps,  # type: ignore[arg-type]
        sampler=itertools.count(first),
        batch_size=None,
        num_workers=workers,
        prefetch_factor=_AHEAD,
        # A worker starts afresh: forking a process that has threads or a GPU may hang.
        multiprocessing_context="spawn",
        worker_init_fn=_leave_interrupts,
        # Otherwise the loader draws a seed for its workers from the global generator.
        generator=torch.Generator(),
    )


def _leave_interrupts(worker: int) -> None:
    # Ctrl-C reaches the whole group; the training process decides what becomes of its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
