"""Pairs whose sensor positions are kept back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from fullturn.data.pair import Pair
from fullturn.data.pair_set import PairSet


class HiddenViewpoints(PairSet):
    """The pairs of another set, without the places of the sensors: how much these help."""

    def __init__(self, pairs: PairSet) -> None:
        self._pairs = pairs
        self.name = f"{pairs.name}/no viewpoints"

    @property
    def description(self) -> dict[str, Any]:
        return {**self._pairs.description, "viewpoints": "hidden"}

    def __len__(self) -> int:
        return len(self._pairs)

    def pair(self, index: int) -> Pair:
        return replace(self._pairs.pair(index), source_viewpoint=None, target_viewpoint=None)

    def group(self, index: int) -> str:
        return self._pairs.group(index)
