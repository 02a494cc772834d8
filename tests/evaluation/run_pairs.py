"""A small set of pairs and methods as files, for the tests of runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fullturn.data.pair import Pair
from fullturn.data.pair_set import PairSet

METHODS = """
import os, signal
import numpy as np
import torch
from fullturn.methods.base import Estimate, Method

class Truth(Method):
    '''Says what the order of the points gives away.'''
    name, summary, reference = "truth", "knows the answer", "this test"
    stated = 0.9

    def estimate(self, source, target, *, rng):
        from fullturn.pose.kabsch import weighted_kabsch
        T = weighted_kabsch(source.points, target.points, torch.ones(len(source.points)).double())
        return Estimate(T[None], torch.tensor([self.stated]).double())

class Silent(Truth):
    name, stated = "silent", None
    def estimate(self, source, target, *, rng):
        return Estimate(torch.eye(4).double()[None])

class Raises(Truth):
    name = "raises"
    def estimate(self, source, target, *, rng):
        if len(source.points) == 31:
            raise ZeroDivisionError("a\\nfault")
        return super().estimate(source, target, rng=rng)

class Broken(Truth):
    name = "broken"
    def estimate(self, source, target, *, rng):
        return Estimate(torch.full((1, 4, 4), float("nan")).double())

class Dies(Truth):
    name = "dies"
    def estimate(self, source, target, *, rng):
        if len(source.points) == 31:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().estimate(source, target, rng=rng)

class Slow(Truth):
    name = "slow"
    def estimate(self, source, target, *, rng):
        import time
        time.sleep(0.05)
        return super().estimate(source, target, rng=rng)
"""


def write_methods(folder: Path) -> str:
    """Where the methods stand, up to the colon."""
    path = folder / "their_methods.py"
    path.write_text(METHODS)
    return str(path)


class ListedPairs(PairSet):
    """Pairs of a list; those with an odd number are the group "odd"."""

    def __init__(self, pairs: list[Pair], *, name: str = "listed/pairs") -> None:
        self.name, self._pairs = name, pairs

    @property
    def description(self) -> dict[str, Any]:
        return {"kind": "listed"}

    def __len__(self) -> int:
        return len(self._pairs)

    def pair(self, index: int) -> Pair:
        return self._pairs[index]

    def group(self, index: int) -> str:
        return "odd" if index % 2 else "even"


def listed_pairs(count: int = 4, *, name: str = "listed/pairs") -> ListedPairs:
    """Moved copies of random clouds of 30, 31, 32 … points."""
    pairs = []
    for number in range(count):
        rng = np.random.default_rng(number)
        source = rng.normal(size=(30 + number, 3)) * (1.0, 0.7, 0.4)
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
        T[:3, 3] = rng.normal(size=3)
        pairs.append(Pair(source, source @ T[:3, :3].T + T[:3, 3], T, f"cloud {number}"))
    return ListedPairs(pairs, name=name)
