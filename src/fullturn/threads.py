"""One torch thread while a registration runs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def one_thread() -> Iterator[None]:
    """Run a block, or a function, with one torch thread; the caller's number is put back.

    The tensors of a registration are small: more threads mostly wait for one another, which costs
    twenty times the time on a busy machine. One also makes the bytes of a result independent of
    how many there are.

    >>> with one_thread():
    ...     torch.get_num_threads()
    1
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
