"""The speed benchmark runs, on small clouds."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import network_speed


def test_rows_of_the_table() -> None:
    row = network_speed.inference(5, 60, repetitions=1)
    assert len(row) == len(network_speed.HEADER)
    assert row[:3] == ("5", "60", "283,446")
    whole, encoder, graphs = (int(cell) for cell in row[3:6])
    assert max(whole, encoder, graphs) > 0
    assert row[6:] == ("–", "–")


def test_training_is_measured() -> None:
    assert network_speed.training(5, 40, batch=2, repetitions=1) > 0


def test_the_command_prints_a_table(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = "network_speed.py --neighbors 3 --sizes 40 --repetitions 1 --batch 0"
    monkeypatch.setattr(sys, "argv", words.split())
    monkeypatch.setattr(network_speed.torch, "set_num_threads", lambda count: None)
    network_speed.main()
    assert "| 3 | 40 |" in capsys.readouterr().out
