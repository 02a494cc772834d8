from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from run_pairs import listed_pairs, write_methods

import fullturn
from fullturn.data.draw import ProtocolPairs
from fullturn.data.pair import Pair
from fullturn.data.protocols import PROTOCOLS
from fullturn.data.shapes import ProceduralShapes
from fullturn.evaluation.predict import Predictor, pair_hash, predict
from fullturn.methods.registry import get
from told_method import Told


@pytest.fixture(scope="module")
def pair() -> Pair:
    shapes = ProceduralShapes(1, seed=3)
    return ProtocolPairs(PROTOCOLS["modelnet40/noisy/180"], shapes, count=1, seed=5).pair(0)


@pytest.mark.parametrize("method", ["consensus", "icp-point"])
def test_it_is_the_pose_that_register_returns(method: str, pair: Pair) -> None:
    answer = predict(get(method)(), pair, seed=0)
    result = fullturn.register(pair.source, pair.target, method=method, seed=0)
    np.testing.assert_array_equal(answer.T_target_source, result.T_target_source)
    assert answer.cpu_seconds > 0
    assert len(answer.alternatives) == len(result.alternatives)
    if method == "consensus":
        assert answer.success_probability == result.success_probability
    else:
        assert answer.success_probability is None  # ICP states none; register asks the verdict


def test_failures_have_a_reason_and_the_identity(tmp_path: Path) -> None:
    home = write_methods(tmp_path)
    pair = listed_pairs(2).pair(1)
    for method, reason in (("Raises", "ZeroDivisionError: a fault"), ("Broken", "rigid")):
        answer = Predictor()((f"{home}:{method}", pair))
        assert reason in str(answer.error)
        np.testing.assert_array_equal(answer.T_target_source, np.eye(4))
        assert answer.success_probability is None


def test_a_method_is_told_the_largest_rotation_if_it_takes_one(pair: Pair) -> None:
    method, limited = Told(), dataclasses.replace(pair, max_rotation_deg=45.0)
    for known, told in ((limited, np.pi / 4), (pair, None)):
        assert predict(method, known, seed=0).error is None
        assert method.max_rotation_rad == told
        assert predict(get("icp-point")(), known, seed=0).error is None


def test_the_hash_is_of_what_a_method_sees(pair: Pair) -> None:
    known = pair_hash(pair)
    again = dataclasses.replace(pair, name="other", T_target_source=np.eye(4))
    assert pair_hash(again) == known
    assert pair_hash(dataclasses.replace(pair, source=pair.target, target=pair.source)) != known
    limits = [pair_hash(dataclasses.replace(pair, max_rotation_deg=x)) for x in (None, 45.0, 46.0)]
    assert limits[0] == known
    assert len(set(limits)) == 3
    nudged = pair.source.copy()
    nudged[0, 0] = np.nextafter(nudged[0, 0], 9)
    assert pair_hash(dataclasses.replace(pair, source=nudged)) != known
    # The same bytes, cut elsewhere.
    both = np.concatenate([pair.source, pair.target])
    moved = dataclasses.replace(pair, source=both[:500], target=both[500:])
    assert pair_hash(moved) != pair_hash(
        dataclasses.replace(pair, source=both[:501], target=both[501:])
    )
