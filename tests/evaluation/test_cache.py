from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fullturn.errors import WriteError
from fullturn.evaluation.cache import PredictionCache
from fullturn.evaluation.predict import Prediction


def prediction(seed: int) -> Prediction:
    rng = np.random.default_rng(seed)
    others = tuple(rng.normal(size=(seed, 4, 4)))
    return Prediction(rng.normal(size=(4, 4)), rng.random(), others, None, rng.random(), 0.5)


def filled(path: Path, count: int = 3) -> PredictionCache:
    cache = PredictionCache(path)
    for number in range(count):
        cache.add(f"pair{number}", prediction(number))
    return cache


def same(one: Prediction, other: Prediction) -> bool:
    return (
        np.array_equal(one.T_target_source, other.T_target_source)
        and one.success_probability == other.success_probability
        and len(one.alternatives) == len(other.alternatives)
        and all(map(np.array_equal, one.alternatives, other.alternatives))
        and (one.error, one.cpu_seconds) == (other.error, other.cpu_seconds)
    )


def test_what_was_kept_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "cache.jsonl"
    filled(path)
    failed = Prediction(np.eye(4), error="ValueError: it said “no”")
    more = PredictionCache(path)
    more.add("failed", failed)
    found = PredictionCache(path)
    assert list(found.found) == ["pair0", "pair1", "pair2", "failed"]
    assert all(same(found.found[f"pair{number}"], prediction(number)) for number in range(3))
    assert same(found.found["failed"], failed)
    assert found.damaged == 0


@pytest.mark.parametrize("cut", [1, 20, 200])
def test_a_line_that_was_cut_off_is_predicted_again(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "cache.jsonl"
    filled(path)
    path.write_bytes(path.read_bytes()[:-cut])
    found = PredictionCache(path)
    # Without its line end alone, the line is whole.
    assert len(found.found) == (3 if cut == 1 else 2)
    found.add("pair2", prediction(2))
    again = PredictionCache(path)
    assert again.damaged == 0
    assert sorted(again.found) == ["pair0", "pair1", "pair2"]


def test_damage_is_counted_and_costs_its_own_line_alone(tmp_path: Path) -> None:
    path = tmp_path / "cache.jsonl"
    filled(path)
    lines = path.read_bytes().splitlines(keepends=True)
    digit = lines[1].index(b".") + 1
    changed = b"5" if lines[1][digit : digit + 1] != b"5" else b"6"
    lines[1] = lines[1][:digit] + changed + lines[1][digit + 1 :]
    path.write_bytes(b"".join([*lines, b'{"no": "prediction"}\n', b"\xff\xfe[]\n", b"[1]\n"]))
    found = PredictionCache(path)
    assert sorted(found.found) == ["pair0", "pair2"]
    assert found.damaged == 4
    assert PredictionCache(path).damaged == 0  # cleaned


def test_a_place_that_cannot_be_used_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(WriteError, match="--cache"):
        PredictionCache(tmp_path)
    blocked = PredictionCache(tmp_path / "file" / "below")
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match="--cache"):
        blocked.add("pair", prediction(0))
