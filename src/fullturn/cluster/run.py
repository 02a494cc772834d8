"""A table of pairs over a cluster: read, skip what is finished, register, write."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fullturn.cluster.client import check_installed, connected
from fullturn.cluster.flight import Flight
from fullturn.cluster.pairs import read_pairs
from fullturn.cluster.store import Store, Tally
from fullturn.cluster.work import make_job
from fullturn.errors import InputError, is_number, whole_number
from fullturn.methods.registry import get
from fullturn.progress import progress_bar
from fullturn.workers import check_workers


@dataclass(frozen=True)
class BatchSummary:
    """How a run ended; the results themselves are in the folder."""

    folder: Path
    done: int
    failures: tuple[tuple[str, str], ...]  # id and reason of each failed pair, in their order
    found: int  # pairs that an earlier run had finished
    seconds: float  # wall-clock, of this run


def run_batch(
    pairs: str | os.PathLike[str],
    *,
    out: str | os.PathLike[str],
    scheduler: str | None = None,
    workers: int | None = None,
    method: str = "auto",
    seed: int = 0,
    part_size: int = 20,
    retry_failed: bool = False,
    patience_seconds: float = 60.0,
    progress: bool = False,
    note: Callable[[str], None] = lambda text: None,
) -> BatchSummary:
    """Register every pair of a CSV table and write the results to the folder `out` as Parquet.

    The work goes to the Dask scheduler at an address, or to `workers` processes started here (by
    default one per CPU; a script calls this from under ``if __name__ == "__main__":``). The results
    are those of `register`, for any number of workers, with a row for each pair; one that fails
    has its reason. Each part of `part_size` pairs is written when it is finished. The same call
    goes on from there after an interruption; with `retry_failed`, it does parts in which a pair
    failed again. `patience_seconds` is how long to wait for workers when there are none; `note` is
    told what a user should know. docs/batch.md has the columns of both tables.

    Raises:
        InputError: the table, an option or the scheduler cannot be used, or `out` holds results of
            other pairs, settings or code.
        ReadError: the table cannot be read.
        WriteError: the folder cannot be written.
        DependencyError: Dask, pyarrow or the method's package is missing.
        FullturnError: the cluster was lost or can't do this work. What is finished is kept.
    """
    begin = time.perf_counter()
    check_installed()
    seed, most = whole_number(seed, "seed", least=0), check_workers(workers)
    part_size = whole_number(part_size, "part_size", least=1)
    if not is_number(patience_seconds) or not 0.0 < patience_seconds < math.inf:
        raise InputError(
            f"patience_seconds: expected a finite number above 0, got {patience_seconds!r:.80}"
        )
    method = _from_anywhere(method)
    table = read_pairs(pairs, method=get(method))
    for name in filter(None, table.unused):
        note(f"{table.path}: the column {name} is not used")
    job = make_job(table.folder, method=method, seed=seed)
    store = Store(out, table, job, part_size=part_size)

    tallies: dict[int, Tally] = {}
    for number, rows in table.parts(part_size):
        tally = store.tally(number, rows)
        if tally is not None and not (retry_failed and tally.failures):
            tallies[number] = tally
    found, finished = sum(map(len, tallies.values())), set(tallies)
    missing = (part for part in table.parts(part_size) if part[0] not in finished)
    if lacking := -(-table.count // part_size) - len(finished):
        with (
            connected(scheduler, workers=min(most, lacking)) as client,
            progress_bar("registering", table.count, shown=progress) as advance,
        ):
            advance(found)
            flight = Flight(client, job, patience_seconds=patience_seconds)
            for number, results in flight.results(missing):
                tallies[number] = store.write(number, results)
                advance(len(results))
    return BatchSummary(
        folder=Path(out),
        done=sum(tally.done for tally in tallies.values()),
        failures=tuple(one for number in sorted(tallies) for one in tallies[number].failures),
        found=found,
        seconds=time.perf_counter() - begin,
    )


def _from_anywhere(method: str) -> str:
    """The method's name; a file in it gets its whole path, whichever folder a worker runs in."""
    home, colon, name = method.rpartition(":") if isinstance(method, str) else ("", "", "")
    if colon and home.endswith(".py"):
        return f"{Path(home).resolve()}:{name}"
    return method
