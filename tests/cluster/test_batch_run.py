"""A batch on real processes: killed, poisoned, interrupted, cut off; no pair is lost or doubled."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from batch_cases import DEADLY, SMALLEST, asked, write_method, write_pairs

from fullturn import register
from fullturn.cluster import BatchSummary, run_batch
from fullturn.cluster.flight import Flight
from fullturn.cluster.pairs import PairRow
from fullturn.cluster.work import make_job
from fullturn.errors import FullturnError, InputError

pytest.importorskip("distributed")
pq = pytest.importorskip("pyarrow.parquet")

CLUSTER = """
import sys
from distributed import LocalCluster

if __name__ == "__main__":
    count = int(sys.argv[1])
    with LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=":0") as cluster:
        pids = [worker.process.process.pid for worker in cluster.workers.values()]
        print(cluster.scheduler_address, *pids, flush=True)
        sys.stdin.read()
"""


@contextmanager
def cluster(
    folder: Path, *, workers: int
) -> Iterator[tuple[subprocess.Popen[str], str, list[int]]]:
    """A cluster that isn't ours: its process, its address, those of its workers."""
    script = folder / "cluster.py"
    script.write_text(CLUSTER)
    with subprocess.Popen(
        [sys.executable, str(script), str(workers)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    ) as process:
        assert process.stdout is not None
        assert process.stdin is not None
        address, *pids = process.stdout.readline().split()
        yield process, address, [int(pid) for pid in pids]
        process.stdin.close()  # which ends it


@pytest.fixture(scope="module")
def two_workers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, list[int]]]:
    with cluster(tmp_path_factory.mktemp("cluster"), workers=2) as (_, address, pids):
        yield address, pids


@contextmanager
def meanwhile(out: Path, pid: int) -> Iterator[None]:
    """Kill a process once the first part is written."""

    def strike() -> None:
        deadline = time.monotonic() + 60
        while not list(out.glob("part-*.parquet")) and time.monotonic() < deadline:
            time.sleep(0.02)
        os.kill(pid, signal.SIGKILL)

    thread = threading.Thread(target=strike)
    thread.start()
    yield
    thread.join()


def results(out: Path) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = pq.read_table(out).to_pylist()
    return rows


def check_row(row: dict[str, Any], folder: Path, number: int, *, method: str) -> None:
    """The row is what `register` says, to the bit."""
    pair = (folder / f"{role}{number}.npy" for role in ("source", "target"))
    expected = register(*pair, method=method)
    assert row["id"] == f"pair {number}"
    assert row["T_target_source"] == expected.T_target_source.ravel().tolist()
    assert row["covariance"] == expected.covariance.ravel().tolist()
    assert row["success_probability"] == expected.success_probability
    assert (row["overlap_source"], row["overlap_target"]) == expected.overlap
    assert row["alternatives"] == len(expected.alternatives)


def test_a_killed_worker_loses_nothing_and_doubles_nothing(
    two_workers: tuple[str, list[int]], tmp_path: Path
) -> None:
    pairs, method, out = write_pairs(tmp_path, 24), write_method(tmp_path), tmp_path / "out"
    address, pids = two_workers
    with meanwhile(out, pids[0]):
        summary = run_batch(pairs, out=out, scheduler=address, method=method, part_size=3)
    assert (summary.done, summary.failures, summary.found) == (24, (), 0)
    assert set(asked(tmp_path)) == {SMALLEST + number for number in range(24)}
    rows = results(out)
    assert len(rows) == 24
    for number, row in enumerate(rows):
        check_row(row, tmp_path, number, method=method)


def test_workers_with_other_code_are_refused(
    two_workers: tuple[str, list[int]], tmp_path: Path
) -> None:
    from distributed import Client

    job = make_job(str(tmp_path), method=write_method(tmp_path), seed=0)
    other_numpy = replace(job, code="other", versions={**job.versions, "numpy": "0.1"})
    with Client(two_workers[0], set_as_default=False) as client:
        for wrong, message in (
            (replace(job, version="0.0.1"), "expected fullturn 0.0.1 on every worker, one has"),
            (other_numpy, "one has numpy .* instead of 0.1; install the same everywhere"),
            (replace(job, code="other"), "one has other files"),
        ):
            flight = Flight(client, wrong, patience_seconds=10)
            with pytest.raises(FullturnError, match=message):
                list(flight.results(iter([(0, [PairRow("0", "a", "b")])])))
    assert asked(tmp_path) == []


def test_a_scheduler_without_workers(tmp_path: Path) -> None:
    pairs = write_pairs(tmp_path, 2)
    with (
        cluster(tmp_path, workers=0) as (_, address, _pids),
        pytest.raises(
            FullturnError, match=r"saw none for 1 s; start some; finished parts are kept"
        ),
    ):
        run_batch(
            pairs, out=tmp_path / "out", scheduler=address, method="icp-point", patience_seconds=1
        )


def test_a_deadly_pair_fails_alone_and_a_missing_file_is_a_row(tmp_path: Path) -> None:
    pairs, method = write_pairs(tmp_path, 8, deadly=[2]), write_method(tmp_path)
    (tmp_path / "target5.npy").unlink()
    summary = run_batch(pairs, out=tmp_path / "out", workers=2, method=method, part_size=4)
    assert summary.done == 6
    (deadly, reason), (missing, other) = summary.failures
    assert (deadly, missing) == ("pair 2", "pair 5")
    assert "the worker process ended each time" in reason
    assert "target5.npy: expected a file" in other
    rows = results(tmp_path / "out")
    assert [row["id"] for row in rows] == [f"pair {number}" for number in range(8)]
    assert [row["status"] for row in rows] == [
        "failed" if number in (2, 5) else "done" for number in range(8)
    ]
    assert rows[2]["T_target_source"] is None
    assert rows[2]["error"] == reason
    # Whatever went with the worker was done again, and the deadly one had tries of its own.
    assert asked(tmp_path).count(DEADLY) >= 3


def test_a_lost_scheduler_keeps_what_is_finished(tmp_path: Path) -> None:
    pairs, method, out = write_pairs(tmp_path, 16), write_method(tmp_path), tmp_path / "out"
    hidden = (tmp_path / "target0.npy").rename(tmp_path / "hidden.npy")

    def run(**options: Any) -> BatchSummary:
        return run_batch(pairs, out=out, method=method, part_size=2, **options)

    with cluster(tmp_path, workers=1) as (process, address, pids):
        with (
            meanwhile(out, process.pid),
            pytest.raises(FullturnError, match=r"connection was lost; finished parts are kept"),
        ):
            run(scheduler=address)
        for pid in pids:  # nobody is left to end them
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
    before = {path.name: path.stat().st_mtime_ns for path in out.glob("part-*")}
    assert 0 < len(before) < 8
    # One of them is damaged meanwhile: it is as good as missing. The first holds a failed pair.
    damaged = max(before)
    (out / damaged).write_bytes(b"PAR1 cut off")
    before = {n: at for n, at in before.items() if n not in ("part-000000.parquet", damaged)}
    (tmp_path / "calls.txt").unlink(missing_ok=True)
    hidden.rename(tmp_path / "target0.npy")

    # Finished here, by one process: only what was missing is done.
    summary = run(workers=1, retry_failed=True)
    assert (summary.done, summary.found) == (16, 2 * len(before))
    missing = [n for n in range(16) if f"part-{n // 2:06d}.parquet" not in before]
    assert sorted(asked(tmp_path)) == [SMALLEST + number for number in missing]
    after = {path.name: path.stat().st_mtime_ns for path in out.glob("part-*")}
    assert {name: after[name] for name in before} == before

    # Nothing is left to do: no cluster is asked for, no pair either.
    again = run(scheduler="tcp://127.0.0.1:1")
    assert (again.done, again.found, len(asked(tmp_path))) == (16, 16, len(missing))
    for number, row in enumerate(results(out)):
        check_row(row, tmp_path, number, method=method)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense", "", "http://127.0.0.1:1"])
def test_a_scheduler_that_cannot_be_reached(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fullturn.cluster.client._CONNECT_SECONDS", 0.5)
    pairs = write_pairs(tmp_path, 2)
    with pytest.raises(InputError, match=r"scheduler: expected the address") as caught:
        run_batch(pairs, out=tmp_path / "out", scheduler=address, method="icp-point")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "options",
    [
        {"part_size": 0},
        {"workers": 0},
        {"seed": -1},
        {"method": "x"},
        {"patience_seconds": "1"},
        {"patience_seconds": 0},
        {"patience_seconds": math.nan},
    ],
)
def test_wrong_options(options: dict[str, Any], tmp_path: Path) -> None:
    pairs = write_pairs(tmp_path, 1)
    with pytest.raises(InputError):
        run_batch(pairs, out=tmp_path / "out", **{"method": "icp-point", **options})
    assert not (tmp_path / "out").exists()
