"""The benchmark scripts that are no verb of the command line, on small data."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

from fullturn.data.draw import ProtocolPairs
from fullturn.data.protocols import PROTOCOLS
from fullturn.data.shapes import ProceduralShapes

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import pair_statistics
import speed


def test_speed_pairs_are_exact_and_its_table_shows_growth(tmp_path: Path) -> None:
    pair = speed.make_pair(500, seed=1)
    assert pair.source.shape == pair.target.shape == (500, 3)
    row = {
        "points": 1000, "repetitions": 1, "cpu_seconds": 0.1, "peak_mib": 300.0,
        "peak_mib_before": 200.0, "stages": {"match": 0.05}, "rotation_error_deg": 0.1,
    }  # fmt: skip
    rows = [row, {**row, "points": 10_000, "cpu_seconds": 1.0}]
    speed.report(rows, method="m", seed=0, out=tmp_path, name="speed")
    text = (tmp_path / "speed.md").read_text()
    assert "n^1.00" in text
    assert "| match | 0.0500 | 0.0500 |" in text


def test_speed_measures_the_whole_call() -> None:
    row = speed.measure("icp-point", 300, seed=0, repetitions=1)
    assert row["cpu_seconds"] > 0
    assert {"explain", "total"} <= set(row["stages"])


@pytest.mark.parametrize(
    ("name", "low", "high"), [("modelnet40/noisy/180", 0.66, 1.0), ("predator/45", 0.0, 1.0)]
)
def test_overlap_is_the_share_of_exact_copies(name: str, low: float, high: float) -> None:
    protocol = pair_statistics.counted(PROTOCOLS[name])
    assert protocol.noise_sigma == 0.0
    for pair in ProtocolPairs(protocol, ProceduralShapes(3), count=5):
        found = pair_statistics.overlap(pair, protocol)
        assert low <= found <= high
        # Nothing of it is left where all points have moved.
        moved = dataclasses.replace(pair, target=pair.target + np.array([9.0, 0, 0]))
        assert pair_statistics.overlap(moved, protocol) == 0.0
