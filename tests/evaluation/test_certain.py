"""How many answers are stated with 0.9 and more, and how many of these are right."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from run_folders import set_part, summary, write_run
from run_pairs import listed_pairs

from fullturn.evaluation.folders import read_runs
from fullturn.evaluation.predict import Prediction
from fullturn.evaluation.score import Score, ScoredPair, summarize
from fullturn.evaluation.tables import full_tables

PAIR = listed_pairs(1).pair(0)


def row(probability: float | None, *, right: bool = True, error: str | None = None) -> Score:
    T = PAIR.T_target_source if right else np.eye(4)
    answer = Prediction(T, success_probability=probability, error=error)
    return ScoredPair(PAIR, index=0).score(answer)


def test_counted_by_hand() -> None:
    rows = [row(0.95), row(0.9, right=False), row(0.99), row(0.89), row(0.1, right=False)]
    found = summarize(rows, seed=0)
    assert found["certain"] == pytest.approx(3 / 5)
    assert found["certain_right"] == pytest.approx(2 / 3)


def test_a_failed_pair_is_not_certain() -> None:
    found = summarize([row(1.0), row(None, right=False, error="it crashed")], seed=0)
    assert found["certain"] == 0.5
    assert found["certain_right"] == 1.0


def test_where_nothing_is_certain_no_share_of_it_is_right() -> None:
    found = summarize([row(0.5), row(0.2)], seed=0)
    assert found["certain"] == 0.0
    assert "certain_right" not in found


def test_without_probabilities_there_is_neither() -> None:
    assert not {"certain", "certain_right"} & summarize([row(None)], seed=0).keys()


def test_both_stand_in_the_full_tables(tmp_path: Path) -> None:
    part = set_part({"ours": summary(certain=0.25, certain_right=1.0), "shy": summary(certain=0.0)})
    (table,) = full_tables(read_runs([write_run(tmp_path / "run", {"scans": part})]))
    headings = [levels[-1] for levels in table.header]
    shown = {
        line[1]: [line[headings.index(name)] for name in ("sure %", "sure, right %")]
        for line in table.rows
    }
    assert shown == {"ours": ["25.0", "100.0"], "shy": ["0.0", "–"]}
    assert any("0.9 or more" in note for note in table.notes)
