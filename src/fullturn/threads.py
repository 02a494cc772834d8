"""Another number of torch threads for a while."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def torch_threads(count: int | None) -> Iterator[None]:
    """Run a block, or a function, with so many torch threads; the caller's number is put back.

    None: as many as there are. A registration takes one: its tensors are small, so that more
    threads mostly wait for one another, which costs twenty times the time on a busy machine. One
    also makes the bytes of a result independent of how many there are.

    >>> with torch_threads(1):
    ...     torch.get_num_threads()
    1
    """
    before = torch.get_num_threads()
    torch.set_num_threads(before if count is None else count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
