"""Which shapes a built MVP-RG set trains and tests on, and which pair shows which of them."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fullturn.data.mvp_rg import MvpRgConfig
from fullturn.data.shapes import MeshSource
from fullturn.errors import InputError

_CATEGORY_SHARE = 1 / 8


class Shape(NamedTuple):
    """Where to find one shape, and what it is."""

    source: int  # by number; test sources follow the other ones
    number: int  # in its source
    name: str
    category: str


def split_shapes(
    sources: Sequence[MeshSource], tests: Sequence[MeshSource], config: MvpRgConfig
) -> dict[str, list[Shape]]:
    """The shapes of each split, in an order that the seed shuffles.

    `tests` are for testing, all of `sources` for training; without `tests`, `sources` are parted,
    every fifth to the test part (by `test_share`), evenly over the categories. Of shapes with one
    name, only the first counts, so no name is in both parts.

    Raises:
        InputError: a split without shapes, or a name on both sides.
    """
    given = _unique(sources, first=0, seed=config.seed)
    if tests:
        apart = _unique(tests, first=len(sources), seed=config.seed)
        both = sorted({shape.name for shape in given} & {shape.name for shape in apart})
        if both:
            raise InputError(
                f"expected test shapes that are none of the training shapes, got {len(both)} names "
                f"in both, {both[0]} among them; take other parts"
            )
        parts = {"train": given, "test": apart}
    else:
        wanted = min(max(round(config.test_share * len(given)), 1), len(given) - 1)
        is_test = np.diff(np.arange(len(given) + 1) * wanted // len(given)) > 0
        parts = {
            "train": [shape for shape, test in zip(given, is_test, strict=True) if not test],
            "test": [shape for shape, test in zip(given, is_test, strict=True) if test],
        }
    for split, shapes in parts.items():
        if config.count(split) and not shapes:
            raise InputError(
                f"expected at least one shape to train and another one to test on, got "
                f"{len(given)}; add shapes"
            )
    return parts


def schedule(shapes: Sequence[Shape], count: int) -> list[Shape]:
    """The shape of each pair: all shapes equally often, but that large categories are held back.

    Each next pair goes to the category with the fewest pairs a shape so far, among those that have
    at most an eighth of all pairs (or twice their even share, where there are fewer than 16); in
    it, to the next shape. So the first pairs show every category, and a longer schedule begins
    with the shorter ones.
    """
    members: dict[str, list[Shape]] = {}
    for shape in shapes:
        members.setdefault(shape.category, []).append(shape)
    categories = list(members)
    size = np.array([len(members[category]) for category in categories])
    share = max(_CATEGORY_SHARE, 2.0 / len(categories))
    used = np.zeros(len(categories), dtype=np.int64)
    chosen = []
    for number in range(1, count + 1):
        load = np.where(used < np.ceil(share * number), used / size, np.inf)
        k = int(load.argmin())
        chosen.append(members[categories[k]][used[k] % size[k]])
        used[k] += 1
    return chosen


def _unique(sources: Sequence[MeshSource], *, first: int, seed: int) -> list[Shape]:
    """All shapes, one a name, sorted by hashes of category and name."""
    shapes: dict[str, Shape] = {}
    for number, source in enumerate(sources, start=first):
        for index in range(len(source)):
            name = source.name(index)
            shapes.setdefault(name, Shape(number, index, name, source.category(index)))

    def key(shape: Shape) -> tuple[bytes, bytes]:
        return _hash(seed, shape.category), _hash(seed, shape.name)

    return sorted(shapes.values(), key=key)


def _hash(seed: int, text: str) -> bytes:
    return hashlib.sha256(f"{seed} {text}".encode()).digest()
