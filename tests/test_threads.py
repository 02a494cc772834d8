"""The number of torch threads: as asked for inside, as before outside, whoever else asks."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch

from fullturn.threads import torch_threads


@pytest.fixture(autouse=True)
def three() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    yield
    torch.set_num_threads(before)


def test_blocks_within_blocks() -> None:
    with torch_threads(2):
        with torch_threads(1):
            assert torch.get_num_threads() == 1
        assert torch.get_num_threads() == 2
        with torch_threads(None):
            assert torch.get_num_threads() == 2
    assert torch.get_num_threads() == 3
    with pytest.raises(KeyError), torch_threads(1):
        raise KeyError
    assert torch.get_num_threads() == 3


def test_blocks_of_two_threads_that_overlap() -> None:
    first, second = torch_threads(1), torch_threads(1)
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert torch.get_num_threads() == 1  # the second is still at work
    second.__exit__(None, None, None)
    assert torch.get_num_threads() == 3
    torch.set_num_threads(2)  # nothing is remembered
    with torch_threads(1):
        pass
    assert torch.get_num_threads() == 2
