"""A batch on a local cluster against one process, and with a worker killed in the middle.

    python benchmarks/cluster.py --pairs 2000 --workers 2

The pairs are made from generated shapes (no data needed) and written as files. One process
registers the first of them (`--alone`), after a warm-up, by `register_many(workers=1)`: that is the
throughput to compare with. The batch's is that of all pairs, its processes' start included. The
same batch is then run on the first `--killed` pairs, one of its workers killed when half of the
parts are written; its rows are compared with those of the batch that nothing happened to.
"""

from __future__ import annotations

import argparse
import csv
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import psutil
import pyarrow.parquet as pq

from fullturn.cluster import BatchSummary, run_batch
from fullturn.data.open import open_shapes, protocol_pairs
from fullturn.evaluation.layout import Table, markdown
from fullturn.evaluation.run import machine
from fullturn.io.save import save_cloud
from fullturn.workers import THREAD_VARIABLES

PROTOCOL = "modelnet40/noisy/180"
TIMES = ("seconds", "cpu_seconds")


def write_pairs(folder: Path, count: int, *, seed: int) -> Path:
    """The table of so many pairs, beside their clouds."""
    shapes = open_shapes(f"procedural:{count}:{seed}")
    ((pairs,), _) = protocol_pairs([PROTOCOL], shapes, count=count, seed=seed)
    lines = [["source", "target"]]
    for number, pair in enumerate(pairs):
        lines.append([f"source{number}.npy", f"target{number}.npy"])
        for name, points in zip(lines[-1], (pair.source, pair.target), strict=True):
            save_cloud(folder / name, points)
    return write_table(folder / "pairs.csv", lines)


def write_table(path: Path, lines: Sequence[Sequence[str]]) -> Path:
    """A CSV file of these lines."""
    with open(path, "w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows(lines)
    return path


def first_rows(table: Path, count: int) -> list[list[str]]:
    """The first line of a table and so many pairs."""
    with open(table, newline="", encoding="utf-8") as stream:
        return list(csv.reader(stream))[: count + 1]


def alone(table: Path, count: int, *, method: str) -> None:
    """Print the wall-clock and CPU seconds that this process takes for the first pairs."""
    import fullturn

    rows = first_rows(table, count)[1:]
    pairs = [tuple(str(table.parent / name) for name in row) for row in rows]
    fullturn.register_many(pairs[:1], method=method, workers=1)
    begin, cpu_begin = time.perf_counter(), time.process_time()
    fullturn.register_many(pairs, method=method, workers=1)
    print(time.perf_counter() - begin, time.process_time() - cpu_begin)


def kill_one_when_half_done(out: Path, parts: int, killed: list[int]) -> None:
    """Kill the worker process that used the most CPU so far, once half of the parts are there."""
    while len(list(out.glob("part-*.parquet"))) < parts // 2:
        time.sleep(0.05)
    processes = [
        process
        for process in psutil.Process().children(recursive=True)
        if "spawn_main" in " ".join(process.cmdline())
    ]
    victim = max(processes, key=lambda process: process.cpu_times().user)
    os.kill(victim.pid, signal.SIGKILL)
    killed.append(victim.pid)


def kill_test(table: Path, whole: Path, count: int, **options: Any) -> list[str]:
    """Run the first pairs with a killed worker; the line of the report."""
    few = write_table(table.with_name("killed.csv"), first_rows(table, count))
    out, killed = table.parent / "killed", list[int]()
    parts = -(-count // options["part_size"])
    thread = threading.Thread(target=kill_one_when_half_done, args=(out, parts, killed))
    thread.start()
    summary = run_batch(few, out=out, **options)
    thread.join()
    found, expected = rows_without_times(out), rows_without_times(whole)[:count]
    ids = [row["id"] for row in found]
    lost = count - len(set(ids))
    twice = len(ids) - len(set(ids))
    differing = sum(a != b for a, b in zip(found, expected, strict=True))
    title = f"batch, {options['workers']} workers, {len(killed)} killed"
    numbers = line(title, count, summary.seconds, sum_of_cpu_seconds(out))
    return [*numbers, f"{lost} / {twice} / {differing}"]


def rows_without_times(out: Path) -> list[dict[str, Any]]:
    """The results, but for what differs from run to run."""
    rows: list[dict[str, Any]] = pq.read_table(out).drop_columns(list(TIMES)).to_pylist()
    return rows


def sum_of_cpu_seconds(out: Path) -> float:
    """Of all pairs, without the start of the processes."""
    return float(sum(pq.read_table(out, columns=["cpu_seconds"])["cpu_seconds"].to_pylist()))


def line(title: str, count: int, seconds: float, cpu_seconds: float) -> list[str]:
    """Title, pairs, seconds, pairs a second, CPU seconds a pair."""
    rate, cost = f"{count / seconds:.2f}", f"{cpu_seconds / count:.3f}"
    return [title, f"{count:,}", f"{seconds:.1f}", rate, cost]


def measure(table: Path, arguments: argparse.Namespace) -> str:
    """Run everything; the report."""
    command = [sys.executable, __file__, "--table", str(table), "--method", arguments.method]
    few = min(arguments.alone, arguments.pairs)
    done = subprocess.run(
        [*command, "--alone", str(few)],
        env={**os.environ, **dict.fromkeys(THREAD_VARIABLES, "1")},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    seconds, cpu_seconds = map(float, done.stdout.split()[-2:])
    options = {
        "method": arguments.method,
        "workers": arguments.workers,
        "part_size": arguments.part_size,
    }
    out = table.parent / "results"
    summary: BatchSummary = run_batch(table, out=out, progress=True, **options)
    # Before the second batch, which has processes of its own.
    worker_mib = peak_mib(resource.RUSAGE_CHILDREN)
    client_mib = peak_mib(resource.RUSAGE_SELF)
    killed = kill_test(table, out, min(arguments.killed, arguments.pairs), **options)
    title = f"batch, {arguments.workers} workers"
    rows = [
        [*line("one process", few, seconds, cpu_seconds), "–"],
        [*line(title, arguments.pairs, summary.seconds, sum_of_cpu_seconds(out)), "–"],
        killed,
    ]
    heads = ("run", "pairs", "seconds", "pairs/s", "CPU s/pair", "rows lost / twice / differing")
    report = Table("cluster", "Batch", tuple((head,) for head in heads), tuple(map(tuple, rows)))
    rate, base = arguments.pairs / summary.seconds, few / seconds
    return (
        f"{markdown(report)}\n{rate / base:.2f} times the throughput of one process; "
        f"{summary.done:,} done, {len(summary.failures):,} failed. Peak memory: {client_mib:.0f} "
        f"MiB in the client, {worker_mib:.0f} MiB in the largest other process. "
        f"{arguments.method}, {PROTOCOL}, {machine()['processor']}, {os.cpu_count()} CPUs."
    )


def peak_mib(whose: int) -> float:
    """The most memory of this process, or of the largest of its finished children."""
    peak = resource.getrusage(whose).ru_maxrss
    # Kibibytes on Linux, bytes on macOS.
    return peak / 1024 if sys.platform != "darwin" else peak / 1024**2


def main() -> None:
    """Make the pairs in a folder of their own, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=2_000)
    parser.add_argument("--alone", type=int, default=100, help="pairs for one process")
    parser.add_argument("--killed", type=int, default=200, help="pairs of the run with a kill")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--part-size", type=int, default=20)
    parser.add_argument("--method", default="auto", help="a registered method")
    parser.add_argument("--seed", type=int, default=0, help="of the pairs")
    parser.add_argument("--table", type=Path, help=argparse.SUPPRESS)  # measure one process here
    arguments = parser.parse_args()
    if arguments.table is not None:
        alone(arguments.table, arguments.alone, method=arguments.method)
        return
    with tempfile.TemporaryDirectory() as folder:
        table = write_pairs(Path(folder), arguments.pairs, seed=arguments.seed)
        print(measure(table, arguments))


if __name__ == "__main__":
    main()
