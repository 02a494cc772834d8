from __future__ import annotations

import numpy as np
import pytest

from fullturn.data.mixture import KINDS, MixedPairs, mixed_pair
from fullturn.data.shapes import ProceduralShapes
from fullturn.errors import InputError

SHAPES = ProceduralShapes(1000, seed=2)


def test_the_kinds_come_in_their_shares() -> None:
    pairs = MixedPairs(SHAPES, count=2000, seed=0)
    drawn = [pairs.group(i) for i in range(2000)]
    for kind, share in KINDS.items():
        assert drawn.count(kind) / 2000 == pytest.approx(share, abs=0.03)


def test_unrelated_pairs_say_so() -> None:
    pairs = MixedPairs(SHAPES, count=30, seed=1)
    kinds = [pairs.group(i) for i in range(30)]
    assert "unrelated" in kinds
    for index, kind in enumerate(kinds):
        if kind in ("unrelated", "noisy"):
            pair = pairs.pair(index)
            assert pair.related == (kind != "unrelated")
            assert np.array_equal(pair.T_target_source, np.eye(4)) == (kind == "unrelated")


def test_pairs_depend_on_seed_and_number_alone() -> None:
    few, many = (MixedPairs([SHAPES], count=count, seed=4) for count in (3, 9))
    direct = mixed_pair([SHAPES], seed=4, number=2)
    assert few.group(2) == direct.kind
    assert few.pair(2).source.tobytes() == many.pair(2).source.tobytes()
    assert few.pair(2).source.tobytes() == direct.pair.source.tobytes()
    assert direct.shape in few.pair(2).name


def test_two_shapes_are_needed() -> None:
    for shapes in (ProceduralShapes(1), []):
        with pytest.raises(InputError, match="two shapes"):
            MixedPairs(shapes, count=1)
