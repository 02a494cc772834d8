"""Parts of the table on their way through a cluster: few at a time, and none lost with a worker."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from fullturn.cluster.pairs import PairRow
from fullturn.cluster.work import Job, failed_row, register_rows
from fullturn.errors import FullturnError, one_line

if TYPE_CHECKING:
    from distributed import Client, Future

Part = tuple[int, list[PairRow]]

_PER_THREAD = 2  # one at work, one that waits beside it
_SUSPECTS = 16  # so many pairs wait at most for a trial of their own
_DEADLY = (
    "the worker process ended each time this pair was tried; there may be too little memory for it"
)
_KEPT = "finished parts are kept: the same command goes on from there"


@dataclass(frozen=True)
class _Task:
    """Some pairs of one part: all of them, or one that is tried by itself."""

    number: int  # of the part
    first: int  # of its rows
    rows: Sequence[PairRow]
    is_trial: bool = False  # nothing else is under way


class Flight:
    """Sends parts to a cluster and gives back their results in the order in which they finish.

    Dask sends a task to another worker when its worker dies, and gives up on one that was there
    when that happened more often than its settings allow. Such a part is sent again pair by pair. A
    pair given up on is tried once more while nothing else is under way, because a worker may die of
    its neighbor; if that ends the same way, the pair is the cause, and fails.
    """

    def __init__(self, client: Client, job: Job, *, patience_seconds: float) -> None:
        self._client, self._job, self._patience_seconds = client, job, patience_seconds
        self._under_way: dict[Future, _Task] = {}
        self._ended: SimpleQueue[Future] = SimpleQueue()
        self._results: dict[int, list[dict[str, Any] | None]] = {}
        self._single: deque[_Task] = deque()
        self._suspects: deque[_Task] = deque()

    def results(self, parts: Iterator[Part]) -> Iterator[tuple[int, list[dict[str, Any]]]]:
        """The number of each part with the results of its pairs, in their order.

        Raises:
            FullturnError: the scheduler or all workers are gone, or can't do this work.
        """
        while True:
            self._send_more(parts)
            if not self._under_way:
                return
            future = self._next_ended()
            task = self._under_way.pop(future)
            answers = self._answers(future, task)
            future.release()
            if answers is None:
                continue
            results = self._results[task.number]
            results[task.first : task.first + len(answers)] = answers
            whole = [result for result in results if result is not None]
            if len(whole) == len(results):
                del self._results[task.number]
                yield task.number, whole

    def _send_more(self, parts: Iterator[Part]) -> None:
        is_trial = any(task.is_trial for task in self._under_way.values())
        # Suspects come first once nothing is under way, and then all of them.
        if not is_trial and not (self._suspects and not self._under_way):
            limit = _PER_THREAD * max(1, self._threads())
            while len(self._under_way) < limit and len(self._suspects) < _SUSPECTS:
                if self._single:
                    self._send(self._single.popleft())
                elif (part := next(parts, None)) is not None:
                    number, rows = part
                    self._results[number] = [None] * len(rows)
                    self._send(_Task(number, 0, rows))
                else:
                    break
        if self._suspects and not self._under_way:
            self._send(self._suspects.popleft())

    def _send(self, task: _Task) -> None:
        future = self._client.submit(register_rows, list(task.rows), self._job, pure=False)
        self._under_way[future] = task
        future.add_done_callback(self._ended.put)

    def _answers(self, future: Future, task: _Task) -> list[dict[str, Any]] | None:
        """The results of a task; None where its pairs have to be sent again."""
        from distributed import CancelledError, KilledWorker

        try:
            answers: list[dict[str, Any]] = future.result(timeout=self._patience_seconds)
        except KilledWorker:
            if task.is_trial:
                return [failed_row(row, _DEADLY) for row in task.rows]
            trials = [
                _Task(task.number, task.first + i, [row], is_trial=len(task.rows) == 1)
                for i, row in enumerate(task.rows)
            ]
            (self._suspects if trials[0].is_trial else self._single).extend(trials)
            return None
        except TimeoutError:  # it went with its worker before it could be fetched
            self._send(task)
            return None
        except CancelledError as error:
            raise self._lost() from error
        except FullturnError as error:
            raise FullturnError(f"{error}; {_KEPT}") from error
        # Anything else is no fault of a pair: those are results.
        except Exception as error:
            self._check_scheduler()
            raise FullturnError(
                f"expected workers that can run this work, got {type(error).__name__}: "
                f"{one_line(error.__cause__ or error)[:300]}; install the same fullturn for all of "
                f"them; {_KEPT}"
            ) from error
        return answers

    def _next_ended(self) -> Future:
        """Wait for a task to end, but not for a cluster that is gone."""
        alone_since: float | None = None
        while True:
            self._check_scheduler()
            try:
                future = self._ended.get(timeout=1.0)
            except Empty:
                if self._threads():
                    alone_since = None
                    continue
                alone_since = alone_since or time.monotonic()
                if time.monotonic() - alone_since > self._patience_seconds:
                    raise FullturnError(
                        f"expected workers at the scheduler, saw none for "
                        f"{self._patience_seconds:.0f} s; start some; {_KEPT}"
                    ) from None
                continue
            self._check_scheduler()
            return future

    def _threads(self) -> int:
        try:
            return sum(self._client.nthreads().values())
        except Exception as error:  # whichever part of the connection broke first
            raise self._lost() from error

    def _check_scheduler(self) -> None:
        # A client that reconnects has lost what was under way all the same.
        is_lost = any(future.cancelled() for future in self._under_way)
        if is_lost or self._client.status != "running":
            raise self._lost()

    def _lost(self) -> FullturnError:
        return FullturnError(f"expected the scheduler to answer, the connection was lost; {_KEPT}")
