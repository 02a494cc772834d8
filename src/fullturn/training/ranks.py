"""One process among those that train together: how they agree."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch
import torch.distributed as dist

from fullturn.errors import InputError


@dataclass(frozen=True)
class Ranks:
    """This process's place among `size` processes; the first one writes."""

    rank: int = 0
    size: int = 1

    @property
    def is_first(self) -> bool:
        return self.rank == 0

    def mean(self, values: list[float], *, device: torch.device) -> list[float]:
        """The mean of each value over the processes."""
        if self.size == 1:
            return values
        shared = torch.tensor(values, dtype=torch.float64, device=device)
        dist.all_reduce(shared)
        return (shared / self.size).tolist()

    def gather(self, value: Any) -> list[Any]:
        """The value of every process, in the order of their ranks."""
        if self.size == 1:
            return [value]
        values: list[Any] = [None] * self.size
        dist.all_gather_object(values, value)
        return values


def choose_device(name: str) -> torch.device:
    """The device that a recipe names; of several GPUs, the one of this process.

    Raises:
        InputError: no such device here.
    """
    count = torch.cuda.device_count()
    if name == "auto":
        name = "cuda" if count else "cpu"
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise InputError(
            f"machine.device: expected auto, cpu, cuda or cuda:N, got {name!r}"
        ) from error
    if device.type != "cuda":
        return device
    index = int(os.environ.get("LOCAL_RANK", "0")) if device.index is None else device.index
    if index >= count:
        raise InputError(
            f"machine.device: expected one of {count} GPUs, got {name} (number {index}); "
            "choose another device, or start fewer processes"
        )
    return torch.device("cuda", index)


@contextmanager
def join_ranks(device: torch.device) -> Iterator[Ranks]:
    """Meet the other processes that torchrun has started, if it has."""
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield Ranks()
        return
    if device.type == "cuda":
        torch.cuda.set_device(device)
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
    try:
        yield Ranks(dist.get_rank(), dist.get_world_size())
        # One that leaves while another still talks to it may abort instead of ending.
        dist.barrier()
    finally:
        dist.destroy_process_group()
