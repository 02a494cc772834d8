"""Parts on their way, on a cluster that is made up: who is blamed for a dead worker, and how much
is under way at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fullturn.cluster.flight import Flight
from fullturn.cluster.pairs import PairRow
from fullturn.cluster.work import Job
from fullturn.errors import FullturnError, InputError

distributed = pytest.importorskip("distributed")

JOB = Job("/", "icp-point", 0, "code")


class MadeUp:
    """A client whose tasks end at once: deadly pairs kill, and so may whatever is beside them."""

    def __init__(self, deadly: set[int], *, threads: int, bystanders: float, seed: int) -> None:
        self.deadly, self.threads, self.bystanders = deadly, threads, bystanders
        self.rng = np.random.default_rng(seed)
        self.status = "running"
        self.under_way = self.most = self.kills = 0

    def nthreads(self) -> dict[str, int]:
        return {"tcp://a": self.threads - 1, "tcp://b": 1}

    def submit(self, work: Any, rows: list[PairRow], job: Job, *, pure: bool) -> MadeUpFuture:
        self.under_way += 1
        self.most = max(self.most, self.under_way)
        return MadeUpFuture(self, rows, alone=self.under_way == 1)


class MadeUpFuture:
    def __init__(self, client: MadeUp, rows: list[PairRow], *, alone: bool) -> None:
        self.client, self.rows, self.alone = client, rows, alone

    def add_done_callback(self, tell: Callable[[Any], None]) -> None:
        tell(self)

    def cancelled(self) -> bool:
        return False

    def release(self) -> None:
        self.client.under_way -= 1

    def result(self, timeout: float) -> list[dict[str, Any]]:
        client = self.client
        dies = bool(client.deadly & {int(row.id) for row in self.rows})
        dies |= not self.alone and client.rng.random() < client.bystanders
        if dies:
            client.kills += 1
            raise distributed.KilledWorker("task", None, 1)
        return [{"id": row.id, "status": "done"} for row in self.rows]


@pytest.mark.parametrize("bystanders", [0.0, 0.4, 1.0])
@pytest.mark.parametrize(
    ("count", "size", "deadly"),
    [
        (1, 1, {0}),
        (50, 7, {0, 6, 7, 49}),
        (40, 1, {3, 5}),
        (60, 6, set(range(0, 60, 2))),
        (9, 9, {}),
    ],
)
def test_only_what_kills_alone_is_blamed(
    count: int, size: int, deadly: set[int], bystanders: float
) -> None:
    client = MadeUp(set(deadly), threads=3, bystanders=bystanders, seed=0)
    rows = [PairRow(str(i), "a", "b") for i in range(count)]
    parts = [(n, rows[i : i + size]) for n, i in enumerate(range(0, count, size))]
    flight = Flight(client, JOB, patience_seconds=1)  # type: ignore[arg-type]
    found = dict(flight.results(iter(parts)))
    assert sorted(found) == list(range(len(parts)))
    results = [result for number in sorted(found) for result in found[number]]
    assert [result["id"] for result in results] == [row.id for row in rows]
    assert {int(r["id"]) for r in results if r["status"] == "failed"} == set(deadly)
    assert client.most <= 6
    assert client.under_way == 0


def test_parts_are_asked_for_as_there_is_room() -> None:
    client = MadeUp(set(), threads=2, bystanders=0.0, seed=0)
    taken = 0

    def parts() -> Any:
        nonlocal taken
        for number in range(100):
            taken += 1
            yield number, [PairRow(str(number), "a", "b")]

    flight = Flight(client, JOB, patience_seconds=1)  # type: ignore[arg-type]
    for finished, _ in enumerate(flight.results(parts()), start=1):
        assert taken - finished < 4


def test_results_that_are_gone_before_they_are_fetched_are_made_again() -> None:
    class Forgetful(MadeUp):
        def submit(self, work: Any, rows: list[PairRow], job: Job, *, pure: bool) -> MadeUpFuture:
            future = super().submit(work, rows, job, pure=pure)
            if self.rng.random() < 0.5:

                def forget(timeout: float) -> Any:
                    raise TimeoutError

                future.result = forget  # type: ignore[method-assign]
            return future

    client = Forgetful(set(), threads=2, bystanders=0.0, seed=0)
    parts = [(number, [PairRow(str(number), "a", "b")]) for number in range(20)]
    flight = Flight(client, JOB, patience_seconds=1)  # type: ignore[arg-type]
    assert sorted(number for number, _ in flight.results(iter(parts))) == list(range(20))


class Broken(MadeUp):
    """Every task ends in one error."""

    error: BaseException = RuntimeError("no")

    def submit(self, work: Any, rows: list[PairRow], job: Job, *, pure: bool) -> Any:
        future = super().submit(work, rows, job, pure=pure)

        def fail(timeout: float) -> Any:
            raise self.error

        future.result = fail  # type: ignore[method-assign]
        return future


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (InputError("expected fullturn 2"), "^expected fullturn 2; finished parts are kept"),
        (ModuleNotFoundError("No module named 'fullturn'"), "ModuleNotFoundError: No module named"),
        (distributed.CancelledError(), "the connection was lost; finished parts are kept"),
    ],
)
def test_what_is_no_fault_of_a_pair_stops_the_run(error: BaseException, message: str) -> None:
    client = Broken(set(), threads=2, bystanders=0.0, seed=0)
    client.error = error
    flight = Flight(client, JOB, patience_seconds=1)  # type: ignore[arg-type]
    with pytest.raises(FullturnError, match=message):
        list(flight.results(iter([(0, [PairRow("0", "a", "b")])])))
