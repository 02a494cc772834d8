"""Runs: the same files whatever happens on the way."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from run_pairs import ListedPairs, listed_pairs, write_methods

from fullturn.errors import InputError, WriteError
from fullturn.evaluation.run import evaluate


def files_of(folder: Path) -> dict[str, bytes]:
    """All files of a run but the times, which no two runs share."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    assert folder / "timing.json" in paths
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in paths
        if path.name != "timing.json"
    }


def rows_of(folder: Path, stem: str = "listed-pairs") -> list[dict[str, str]]:
    with open(folder / "pairs" / f"{stem}.csv", newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_a_run_writes_rows_summaries_and_times(tmp_path: Path) -> None:
    home = write_methods(tmp_path)
    advanced: list[int] = []
    summary = evaluate(
        [listed_pairs(4)],
        [f"{home}:Truth", f"{home}:Silent"],
        out=tmp_path / "run",
        cache=tmp_path / "cache",
        advance=advanced.append,
    )
    assert (tmp_path / "run" / "summary.json").read_text() == json.dumps(summary, indent=1) + "\n"
    part = summary["sets"]["listed/pairs"]
    assert list(summary["methods"]) == list(part["methods"]) == ["truth", "silent"]
    assert part["methods"]["truth"]["success"] == 1.0
    assert part["methods"]["truth"]["calibration_error"] == pytest.approx(0.1)
    assert "calibration_error" not in part["methods"]["silent"]
    assert part["groups"]["odd"]["silent"]["n"] == 2
    rows = rows_of(tmp_path / "run")
    assert [row["method"] for row in rows] == ["truth"] * 4 + ["silent"] * 4
    assert rows[1]["name"] == "cloud 1"
    assert rows[5]["success_probability"] == rows[5]["error"] == ""
    assert sum(advanced) == 8
    timing = json.loads((tmp_path / "run" / "timing.json").read_text())
    assert timing["commit"] == json.loads((tmp_path / "run" / "summary.json").read_text())["commit"]
    assert timing["machine"]["threads"] == 1
    times = timing["sets"]["listed/pairs"]["truth"]
    assert times["cpu_seconds_mean"] > 0
    assert sorted(times["groups"]) == ["even", "odd"]


def test_failures_are_rows_with_their_reason(tmp_path: Path) -> None:
    home = write_methods(tmp_path)
    summary = evaluate(
        [listed_pairs(4)],
        [f"{home}:{name}" for name in ("Raises", "Dies", "Broken")],
        out=tmp_path / "run",
        cache=tmp_path / "cache",
        workers=2,
    )
    found = summary["sets"]["listed/pairs"]["methods"]
    assert {name: part["errors"] for name, part in found.items()} == {
        "raises": 1,
        "dies": 1,
        "broken": 4,
    }
    assert [part["n"] for part in found.values()] == [4, 4, 4]
    assert found["dies"]["success"] == 0.75
    rows = rows_of(tmp_path / "run")
    assert rows[1]["error"].startswith("method raises, estimate(): ZeroDivisionError: a fault (")
    assert "exit code -9" in rows[5]["error"]
    assert all("rigid" in row["error"] for row in rows[8:])


def test_from_the_cache_the_same_files_and_nothing_is_predicted(tmp_path: Path) -> None:
    home = write_methods(tmp_path)
    for name in ("first", "second"):
        evaluate([listed_pairs(3)], [f"{home}:Slow"], out=tmp_path / name, cache=tmp_path / "cache")
    assert files_of(tmp_path / "first") == files_of(tmp_path / "second")
    times = [(tmp_path / name / "timing.json").read_bytes() for name in ("first", "second")]
    assert times[0] == times[1]  # they come from the cache, too
    (store,) = (tmp_path / "cache").rglob("*.jsonl")
    assert len(store.read_text().splitlines()) == 3


def test_more_pairs_and_other_workers_use_what_is_there(tmp_path: Path) -> None:
    home = write_methods(tmp_path)
    cache = tmp_path / "cache"
    evaluate([listed_pairs(2)], [f"{home}:Truth"], out=tmp_path / "few", cache=cache)
    evaluate([listed_pairs(5)], [f"{home}:Truth"], out=tmp_path / "more", cache=cache, workers=2)
    evaluate([listed_pairs(5)], [f"{home}:Truth"], out=tmp_path / "anew", cache=tmp_path / "other")
    assert files_of(tmp_path / "more") == files_of(tmp_path / "anew")


def test_a_damaged_cache_is_said_and_healed(tmp_path: Path) -> None:
    home = write_methods(tmp_path)
    options = {"out": tmp_path / "run", "cache": tmp_path / "cache"}
    evaluate([listed_pairs(3)], [f"{home}:Truth"], **options)
    before = files_of(tmp_path / "run")
    (store,) = (tmp_path / "cache").rglob("*.jsonl")
    lines = store.read_text().splitlines(keepends=True)
    store.write_text(lines[0] + lines[1][:50] + "\n" + lines[2])
    notes: list[str] = []
    evaluate([listed_pairs(3)], [f"{home}:Truth"], **options, note=notes.append)
    assert files_of(tmp_path / "run") == before
    assert len(notes) == 1
    assert "1 damaged line" in notes[0]


SCRIPT = """
import sys
from pathlib import Path
sys.path.insert(0, {here!r})
from run_pairs import listed_pairs
from fullturn.evaluation.run import evaluate

if __name__ == "__main__":
    evaluate(
        [listed_pairs(30), listed_pairs(12, name="second")],
        [{home!r} + ":Slow", {home!r} + ":Truth"],
        out=Path({out!r}), cache=Path({cache!r}), workers=2,
    )
"""


def start(folder: Path, out: str, cache: str) -> subprocess.Popen[bytes]:
    script = folder / f"{out}.py"
    places = {"out": str(folder / out), "cache": str(folder / cache)}
    home = write_methods(folder)
    script.write_text(SCRIPT.format(here=str(Path(__file__).parent), home=home, **places))
    return subprocess.Popen(
        [sys.executable, str(script)],
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The files of the run that nobody stops."""
    folder = tmp_path_factory.mktemp("undisturbed")
    assert start(folder, "whole", "cache").wait(120) == 0
    return files_of(folder / "whole")


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_stopped_and_resumed_is_the_same_to_the_byte(
    tmp_path: Path, how: signal.Signals, undisturbed: dict[str, bytes]
) -> None:
    stopped = start(tmp_path, "run", "cache")
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and stopped.poll() is None:
        stores = list((tmp_path / "cache").rglob("slow-*.jsonl"))
        if stores and len(stores[0].read_text().splitlines()) >= 5:
            break
        time.sleep(0.01)
    os.killpg(stopped.pid, how)
    assert stopped.wait(60) != 0
    assert not (tmp_path / "run" / "summary.json").exists()
    assert start(tmp_path, "run", "cache").wait(120) == 0
    assert files_of(tmp_path / "run") == undisturbed


def test_what_cannot_be_run_is_said_before_any_pair(tmp_path: Path) -> None:
    home = write_methods(tmp_path)
    options = {"out": tmp_path / "run", "cache": tmp_path / "cache"}
    with pytest.raises(InputError, match="no-such-method"):
        evaluate([listed_pairs(1)], ["no-such-method"], **options)
    with pytest.raises(InputError, match="truth twice"):
        evaluate([listed_pairs(1)], [f"{home}:Truth", f"{home}:Truth"], **options)
    with pytest.raises(InputError, match="different names"):
        evaluate([listed_pairs(1), listed_pairs(2)], [f"{home}:Truth"], **options)
    with pytest.raises(InputError, match="at least one"):
        evaluate([], [f"{home}:Truth"], **options)
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match="folder"):
        evaluate([listed_pairs(1)], [f"{home}:Truth"], **{**options, "out": tmp_path / "file"})
    assert not (tmp_path / "cache").exists()


def test_identical_pairs_are_predicted_once(tmp_path: Path) -> None:
    home = write_methods(tmp_path)
    pair = listed_pairs(1).pair(0)
    summary = evaluate(
        [ListedPairs([pair, pair])], [f"{home}:Truth"], out=tmp_path / "run", cache=tmp_path / "c"
    )
    assert summary["sets"]["listed/pairs"]["methods"]["truth"]["n"] == 2
    (store,) = (tmp_path / "c").rglob("*.jsonl")
    assert len(store.read_text().splitlines()) == 1


def test_what_failed_is_tried_again(tmp_path: Path) -> None:
    home = write_methods(tmp_path)
    for _ in range(2):
        evaluate(
            [listed_pairs(4)], [f"{home}:Raises"], out=tmp_path / "run", cache=tmp_path / "cache"
        )
        (store,) = (tmp_path / "cache").rglob("*.jsonl")
        assert len(store.read_text().splitlines()) == 3
