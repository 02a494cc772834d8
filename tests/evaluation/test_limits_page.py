"""The scripts behind the page of limits and the covariance table, on small data."""

from __future__ import annotations

import csv
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.linalg import expm

pytest.importorskip("matplotlib")
sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from run_folders import set_part, summary, write_run
from run_pairs import listed_pairs, write_methods

import covariance
import limits
from fullturn.data.draw import ProtocolPairs
from fullturn.data.pair_set import PairSet
from fullturn.data.protocols import PROTOCOLS
from fullturn.data.shapes import ProceduralShapes
from fullturn.evaluation.folders import read_runs
from fullturn.evaluation.run import evaluate
from fullturn.geometry.motion import move
from fullturn.methods.registry import get


def row(name: str, probability: float, **other: object) -> limits.Row:
    known = {"set": "scans", "index": 0, "group": "", "related": True, "error_deg": 90.0}
    known |= {"fits": True, "among": False}
    return limits.Row(**{**known, "name": name, "probability": probability, **other})  # type: ignore


class TestCovariance:
    def test_right_covariances_are_calibrated_whatever_their_frame(self) -> None:
        rng = np.random.default_rng(0)
        squares = []
        for _ in range(1200):
            root = rng.normal(size=(6, 6)) * 0.01
            twist = root @ rng.normal(size=6)
            generator = np.zeros((4, 4))
            x, y, z = twist[:3]
            generator[:3, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
            generator[:3, 3] = twist[3:]
            found = np.eye(4)
            found[:3, 3] = rng.normal(size=3)
            true = found @ expm(generator)
            squares.append(covariance.normalized_square(found, true, root @ root.T))
        told = covariance.summarize(squares)
        assert told["right"] == 1200
        assert told["median_ratio"] == pytest.approx(1.0, abs=0.1)
        assert told["factor"] == pytest.approx(1.0, abs=0.1)
        for level, share in told["inside"].items():
            assert share == pytest.approx(float(level), abs=0.03)

    def test_the_factor_undoes_a_covariance_that_is_too_small(self) -> None:
        squares = 4.0 * np.random.default_rng(1).chisquare(6, 4000)
        told = covariance.summarize(list(squares))
        assert told["median_ratio"] == pytest.approx(4.0, rel=0.06)
        assert told["factor"] == pytest.approx(4.0, rel=0.06)
        assert told["inside"]["0.9"] < 0.5

    def test_what_no_factor_mends_is_counted(self) -> None:
        told = covariance.summarize([5.0, 5.0, 0.05, 126.5])
        assert (told["beyond"], told["loose"]) == (0.25, 0.25)

    def test_only_right_answers_count(self, monkeypatch: pytest.MonkeyPatch) -> None:
        pairs = listed_pairs(4)
        truths = {len(pair.source): pair.T_target_source for pair in pairs}

        def register(source: np.ndarray, target: np.ndarray, **_: object) -> SimpleNamespace:
            odd = len(source) % 2
            T = np.diag([-1.0, -1.0, 1.0, 1.0]) if odd else truths[len(source)]
            return SimpleNamespace(T_target_source=T, covariance=np.eye(6))

        monkeypatch.setattr(covariance.fullturn, "register", register)
        told = covariance.measure(pairs)
        assert (told["n"], told["right"]) == (4, 2)
        assert told["squares"] == pytest.approx([0.0, 0.0], abs=1e-20)

    def test_the_page_has_a_line_a_set_and_dashes_where_nothing_is_right(self) -> None:
        good = {"n": 9, **covariance.summarize([5.0] * 8)}
        text = covariance.page({"a": good, "b": {"n": 9, "right": 0}})
        assert "| a | 9 | 8 | 0.93 | 100.0 % | 100.0 % | 100.0 % | 0.47 | 0.0 % | 0.0 % |" in text
        assert "| b | 9 | 0 | – | – | – | – | – | – | – |" in text


class TestLimits:
    def test_counts_are_of_wrong_answers_to_related_pairs(self) -> None:
        rows = [
            row("a", 0.95),
            row("b", 0.5, fits=False, among=True),
            row("c", 0.99, error_deg=1.0),
            row("d", 0.93, related=False),
        ]
        table = limits.counts_table({"scans": rows})
        assert table.rows == (("scans", "3", "2", "1", "1", "1"),)
        (line,) = limits.unrelated_lines({"scans": rows, "other": [row("e", 0.1)]})
        assert "of 1 pairs, 1 get more than 0.2, 1 more than 0.5, and 1 0.9" in line

    def test_kinds_take_turns_and_no_shape_comes_twice(self) -> None:
        rows = [
            row("a", 0.9),
            row("b", 0.8),
            row("a", 0.7, fits=False),
            row("c", 0.6, fits=False),
            row("d", 0.3, group="low overlap"),
            row("e", 0.99, error_deg=1.0),
            row("f", 0.99, related=False),
        ]
        assert [one.name for one in limits.candidates({"scans": rows})] == ["a", "d", "b", "c"]

    def test_errors_are_told_by_overlap(self) -> None:
        far, near = listed_pairs(2)
        far = replace(far, target=far.target + 100.0)
        near = replace(near, target=move(near.T_target_source, near.source))
        pairs = cast(PairSet, SimpleNamespace(pair=[near, far].__getitem__))
        rows = [
            row("a", 0.9, index=0, error_deg=1.0),
            row("b", 0.2, index=1, error_deg=50.0),
            row("c", 0.4, index=1, error_deg=30.0),
            row("d", 0.9, index=0, error_deg=np.nan),
            row("e", 0.9, index=0, related=False),
        ]
        low, high = limits.overlap_table(rows, pairs).rows
        assert low == ("0 to 10 %", "2", "2", "40.00°", "26.67°", "0.30")
        assert high == ("40 to 100 %", "1", "0", "1.00°", "0.33°", "0.90")

    def test_scans_of_one_object_are_one_shape(self) -> None:
        assert row("dragon/a.ply-b.ply", 0.5, set="stanford").shape == "dragon"
        assert row("pack/models/stapler/textured.obj", 0.5).shape == "stapler/textured.obj"

    def test_rows_of_a_run_folder(self, tmp_path: Path) -> None:
        run = write_run(tmp_path / "run", {"scans": set_part({"ours": summary()})})
        (result,) = read_runs([run])
        rows = limits.read_rows(result, "ours")
        # The last pair failed; the others are 0.2°, 0.8° and 3.2° off.
        assert [one.wrong for one in rows] == [False, False, False, True]
        assert [one.probability for one in rows] == [0.95, 0.75, 0.55, 0.0]

    def test_the_page_keeps_what_stands_around_the_marks(self) -> None:
        page = f"# Title\n\n{limits.BEGIN}\nold\n{limits.END}\n\nMore.\n"
        part = limits.section({"scans": [row("a", 0.95)]}, {}, [], "p.png")
        text = limits.rewrite(page, part, limits.BEGIN, limits.END)
        assert text.startswith("# Title\n")
        assert text.endswith("\n\nMore.\n")
        assert "old" not in text
        assert "| scans | 1 | 1 | 1 | 0 | 1 |" in text
        assert "p.png" not in text
        assert limits.rewrite(text, part, limits.BEGIN, limits.END) == text
        with pytest.raises(SystemExit, match="put them back"):
            limits.rewrite("# Title", part, limits.BEGIN, limits.END)

    def test_failures_of_a_run_are_made_again_and_drawn(self, tmp_path: Path) -> None:
        shapes = ProceduralShapes(9, seed=2)
        pairs = ProtocolPairs(PROTOCOLS["geotransformer/180"], shapes, count=4, seed=3)
        silent = write_methods(tmp_path) + ":Silent"
        evaluate([pairs], [silent], out=tmp_path / "run", cache=tmp_path / "cache")
        (result,) = read_runs([tmp_path / "run"])
        rows = {pairs.name: limits.read_rows(result, "silent")}
        results = {pairs.name: result}
        found = list(limits.fail_again(results, rows, get(silent)(), folders=[]))
        assert {one.row.index for one in found} == {0, 1, 2, 3}
        with open(tmp_path / "run/pairs/geotransformer-180.csv", newline="") as stream:
            written = {int(line["index"]): line for line in csv.DictReader(stream)}
        for one in found:
            angle = float(written[one.row.index]["rotation_error_deg"])
            assert one.score.rotation_error_deg == pytest.approx(angle, rel=1e-4)
        figure = limits.draw(found[:3])
        assert [len(spot.axes) for spot in figure.subfigs] == [2, 2, 2, 0]
        assert figure.subfigs[0].axes[0].get_title() == "found"

    def test_other_pairs_of_the_same_name_are_not_shown(self) -> None:
        shapes = ProceduralShapes(9, seed=2)
        name = "geotransformer/180"
        told = ProtocolPairs(PROTOCOLS[name], shapes, count=4, seed=3).description
        again = limits.reopen(told, name, [])
        assert again is not None
        assert (
            again.pair(1).name
            == ProtocolPairs(PROTOCOLS[name], shapes, count=4, seed=3).pair(1).name
        )
        cleaner = {**told, "protocol": {**told["protocol"], "noise_sigma": 0.0}}
        assert limits.reopen(cleaner, name, []) is None
        assert limits.reopen({**told, "known": "nothing"}, name, []) is None
        lost = {**told, "shapes": {"kind": "mesh pack", "file": "nowhere.npz"}}
        assert limits.reopen(lost, name, []) is None
