"""Numbered pairs with known poses: what every set of pairs answers, whatever it is made from."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any

from fullturn.data.pair import Pair
from fullturn.errors import InputError


class PairSet(ABC):
    """Registration problems by number: the same at every reading, in any order, in any process."""

    name: str  # what the set is called in tables, for example "modelnet40/noisy/180"

    @property
    @abstractmethod
    def description(self) -> dict[str, Any]:
        """What it was made from, as JSON values: rules, seed, count, hashes, never folders."""

    @abstractmethod
    def __len__(self) -> int:
        """The number of pairs."""

    @abstractmethod
    def pair(self, index: int) -> Pair:
        """Pair `index`, from 0; the same bytes at every call."""

    def group(self, index: int) -> str:
        """The class of pair `index` that is summed up apart, "" where the set has none."""
        self._check_index(index)
        return ""

    def __iter__(self) -> Iterator[Pair]:
        return (self.pair(index) for index in range(len(self)))

    def _check_index(self, index: int) -> None:
        if not 0 <= index < len(self):
            raise InputError(
                f"expected a pair of {self.name} from 0 to {len(self) - 1}, got {index}; "
                "ask for one that is there"
            )


def check_count(count: int) -> int:
    """The number of pairs to make, if it is one."""
    if count < 1:
        raise InputError(f"expected at least 1 pair, got count {count}; ask for more")
    return count
