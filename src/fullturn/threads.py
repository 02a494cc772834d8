"""Another number of torch threads for a while."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

import torch

_lock = Lock()
_numbers: dict[object, int] = {}  # outside of all blocks (None), then of each block, newest last


@contextmanager
def torch_threads(count: int | None) -> Iterator[None]:
    """Run a block, or a function, with so many torch threads; the number outside is put back.

    None: as many as there are. A registration takes one: its tensors are small, so that more
    threads mostly wait for one another, which costs twenty times the time on a busy machine. One
    also makes the bytes of a result independent of how many there are. PyTorch has one number for
    all threads of Python, so that of several blocks at once the last to end puts it back.

    >>> with torch_threads(1):
    ...     torch.get_num_threads()
    1
    """
    block = object()
    with _lock:
        before = torch.get_num_threads()
        _numbers.setdefault(None, before)
        _numbers[block] = before if count is None else count
        torch.set_num_threads(_numbers[block])
    try:
        yield
    finally:
        with _lock:
            del _numbers[block]
            torch.set_num_threads(next(reversed(_numbers.values())))
            if len(_numbers) == 1:
                _numbers.clear()
