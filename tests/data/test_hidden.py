from __future__ import annotations

import pytest

from fullturn.data.draw import ProtocolPairs
from fullturn.data.hidden import BlindPairs
from fullturn.data.mixture import MixedPairs
from fullturn.data.pair_set import PairSet
from fullturn.data.protocols import PROTOCOLS
from fullturn.data.shapes import ProceduralShapes

SHAPES = ProceduralShapes(50, seed=4)


@pytest.mark.parametrize(
    "pairs",
    [
        ProtocolPairs(PROTOCOLS["rpmnet/45"], SHAPES, count=2),
        ProtocolPairs(PROTOCOLS["mvp-rg"], SHAPES, count=2),
        MixedPairs(SHAPES, count=6, seed=3),
    ],
)
def test_only_what_is_known_is_kept_back(pairs: PairSet) -> None:
    blind = BlindPairs(pairs)
    assert (blind.name, len(blind)) == (f"{pairs.name}/blind", len(pairs))
    assert blind.description["known"] == "nothing"
    assert "told_rotation_deg" not in blind.description
    assert blind.description["seed"] == pairs.description["seed"]
    for index in range(len(pairs)):
        one, other = pairs.pair(index), blind.pair(index)
        assert blind.group(index) == pairs.group(index)
        for field in ("source", "target", "T_target_source"):
            assert getattr(one, field).tobytes() == getattr(other, field).tobytes()
        assert (one.name, one.related) == (other.name, other.related)
        for field in ("source_viewpoint", "target_viewpoint", "max_rotation_deg"):
            assert getattr(other, field) is None
