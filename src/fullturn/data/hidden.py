"""Pairs of which nothing is told but their clouds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from fullturn.data.pair import Pair
from fullturn.data.pair_set import PairSet

BLIND = "/blind"  # after the name of the set


class BlindPairs(PairSet):
    """The pairs of another set, without what may be known of them: how much that helps.

    Kept back are the places of the sensors and the largest rotation.
    """

    def __init__(self, pairs: PairSet) -> None:
        self._pairs = pairs
        self.name = f"{pairs.name}{BLIND}"

    @property
    def description(self) -> dict[str, Any]:
        known = self._pairs.description
        kept = {key: value for key, value in known.items() if key != "told_rotation_deg"}
        return {**kept, "known": "nothing"}

    def __len__(self) -> int:
        return len(self._pairs)

    def pair(self, index: int) -> Pair:
        return replace(
            self._pairs.pair(index),
            source_viewpoint=None,
            target_viewpoint=None,
            max_rotation_deg=None,
        )

    def group(self, index: int) -> str:
        return self._pairs.group(index)
