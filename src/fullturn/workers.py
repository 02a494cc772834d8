"""Worker processes for many tasks; one that dies costs one task."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any, ParamSpec, TypeVar

from fullturn.errors import FullturnError, InputError, one_line, whole_number

P = ParamSpec("P")
T = TypeVar("T")

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_CANNOT_START = (
    "worker processes cannot start: call this from under "
    '`if __name__ == "__main__":`, or with workers=1'
)


class Crew:
    """Worker processes that answer tasks one by one; they stay from one list of tasks to the next.

    Each worker has one thread, keeps `work` between tasks and starts afresh ("spawn"), so `work`
    and tasks must pickle. Leaving the block stops the workers.
    """

    def __init__(self, work: Callable[[Any], Any], *, workers: int) -> None:
        self._work, self._most = work, workers
        self._crew: dict[Connection, _Worker] = {}

    def __enter__(self) -> Crew:
        return self

    def __exit__(self, *error: object) -> None:
        for worker in self._crew.values():
            worker.stop()

    def run(
        self,
        tasks: Iterable[Any],
        done: Callable[[int, Any], None],
        *,
        portable: Callable[[Any], Any] = lambda task: task,
    ) -> None:
        """Call ``done(number, work(task))`` for every task, in the order in which they finish.

        `portable` turns a task into one that pickles. A task that raises, whose process dies, or
        that cannot be sent, gives a FullturnError in place of its result.

        Raises:
            FullturnError: worker processes cannot start.
        """
        waiting = enumerate(tasks)

        def feed(worker: _Worker) -> None:
            worker.number = None
            for number, task in waiting:
                sent = attempt(worker.give, number, portable, task)
                if sent is None:
                    return
                done(number, sent)

        for worker in self._crew.values():
            feed(worker)
        while len(self._crew) < self._most:
            self._hire()
        # A worker that is still starting may find nothing left to do.
        while busy := [pipe for pipe, worker in self._crew.items() if worker.is_awaited]:
            for pipe in wait(busy):
                worker = self._crew[pipe]  # type: ignore[index]
                try:
                    result = worker.receive()
                except (EOFError, OSError):
                    del self._crew[worker.pipe]
                    worker.stop()
                    if worker.number is None:
                        raise FullturnError(_CANNOT_START) from None
                    done(worker.number, worker.obituary())
                    self._hire()
                    continue
                if worker.number is not None:
                    done(worker.number, result)
                feed(worker)

    def _hire(self) -> None:
        with one_thread_each(), interrupts_held():
            worker = _Worker(self._work)
            self._crew[worker.pipe] = worker


def check_workers(workers: Any) -> int:
    """The number of worker processes; None: as many as there are CPUs for this process.

    Raises:
        InputError: not a whole number of at least 1.
    """
    if workers is None:
        if hasattr(os, "sched_getaffinity"):
            return len(os.sched_getaffinity(0))
        return os.cpu_count() or 1
    return whole_number(workers, "workers", least=1)


class _Worker:
    """One process that says it is ready, then answers one task after the other."""

    def __init__(self, work: Callable[[Any], Any]) -> None:
        context = multiprocessing.get_context("spawn")
        self.number: int | None = None  # of the task at work
        self.has_started = False
        self.pipe, other = context.Pipe()
        self.process = context.Process(target=_serve, args=(other, work), daemon=True)
        try:
            self.process.start()
        except RuntimeError as error:  # this is itself a process that is still starting
            raise FullturnError(_CANNOT_START) from error
        other.close()

    @property
    def is_awaited(self) -> bool:
        """Whether it owes an answer, or the word that it is ready."""
        return self.number is not None or not self.has_started

    def receive(self) -> Any:
        answer = self.pipe.recv()
        self.has_started = True
        return answer

    def give(self, number: int, portable: Callable[[Any], Any], task: Any) -> None:
        task = portable(task)
        try:
            self.pipe.send(task)
        except (BrokenPipeError, ConnectionError):
            pass  # the worker died; reading from it says so
        # Pickling an unknown object raises whatever that object raises.
        except Exception as error:
            raise InputError(
                f"expected clouds that can be sent to a worker process, got one that cannot "
                f"({one_line(error)[:120]}); give arrays or file paths"
            ) from error
        self.number = number

    def obituary(self) -> FullturnError:
        return FullturnError(
            f"the worker process ended without an answer (exit code {self.process.exitcode}); "
            "there may be too little memory for this pair: use fewer workers"
        )

    def stop(self) -> None:
        self.pipe.close()
        self.process.terminate()
        self.process.join()


def _serve(pipe: Connection, work: Callable[[Any], Any]) -> None:
    # Where `interrupts_held` can do nothing, here at least.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answer: Any = "ready"
    while True:
        try:
            pipe.send(answer)
            task = pipe.recv()
        except (EOFError, BrokenPipeError):
            return  # the parent is gone, or has let go
        answer = attempt(work, task)


def attempt(work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T | FullturnError:
    """What ``work(…)`` returns, or whatever it raises as an error of this one task."""
    try:
        return work(*args, **kwargs)
    except FullturnError as error:
        error.__cause__ = error.__context__ = None  # frames would keep the clouds in memory
        return error.with_traceback(None)
    # A fault in one task must not cost the others their results.
    except Exception as error:
        return FullturnError(f"unexpected {type(error).__name__}: {one_line(error)}")


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Worker processes read these variables before they load their libraries."""
    before = {variable: os.environ.get(variable) for variable in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for variable, value in before.items():
            if value is None:
                del os.environ[variable]
            else:
                os.environ[variable] = value


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Ctrl-C waits until the end; processes that start here, or in threads that do, never hear it.

    A terminal sends it to all of them, also to those that still load their libraries; the process
    that started the others decides what becomes of them. Without effect on Windows.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # which would end the hold when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
