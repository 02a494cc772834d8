"""Many registrations at once, in worker processes; none of them stops the others."""

from __future__ import annotations

import multiprocessing
import operator
import os
from collections.abc import Callable, Iterable
from multiprocessing.connection import Connection, wait
from typing import Any

from fullturn.errors import FullturnError, InputError
from fullturn.io.atomic import one_line
from fullturn.io.load import load_cloud
from fullturn.methods.registry import get
from fullturn.result import Registration

Outcome = Registration | FullturnError


class RegistrationInterrupted(KeyboardInterrupt):
    """Ctrl-C during `register_many`: `results` holds the finished pairs, None for the others.

    It is a KeyboardInterrupt, so that a script that knows nothing of it stops, as it was asked to.
    """

    def __init__(self, results: list[Outcome | None]) -> None:
        done = sum(result is not None for result in results)
        super().__init__(f"interrupted after {done} of {len(results)} pairs")
        self.results = results


def register_many(
    pairs: Iterable[tuple[Any, Any]],
    *,
    method: str = "auto",
    seed: int = 0,
    workers: int | None = None,
    progress: bool = False,
) -> list[Outcome]:
    """Register every (source, target) pair; a pair that fails becomes its error in the list.

    The results are those of `register(source, target, method=method, seed=seed)`, bit for bit, for
    any number of workers. `workers` defaults to the number of CPUs; 1 stays in this process.
    Workers start afresh ("spawn"): a script calls this from under ``if __name__ == "__main__":``.

    Raises:
        InputError: `pairs`, `method`, `seed` or `workers` cannot be used at all.
        FullturnError: worker processes cannot start.
        RegistrationInterrupted: Ctrl-C; it carries the finished results.
    """
    get(method)
    check_seed(seed)
    if isinstance(pairs, (str, bytes)) or not isinstance(pairs, Iterable):
        raise InputError(
            f"pairs: expected (source, target) pairs, got a {type(pairs).__name__}; give a list"
        )
    if workers is not None and (
        isinstance(workers, bool) or int(workers) != workers or workers < 1
    ):
        raise InputError(f"workers: expected a whole number of at least 1, got {workers!r}")
    todo = list(pairs)
    count = min(int(workers) if workers else _cpus(), len(todo))
    results: list[Outcome | None] = [None] * len(todo)
    options = {"method": method, "seed": seed}
    with _Progress(len(todo), shown=progress) as advance:
        try:
            run = _run_here if count <= 1 else _run_workers
            run(todo, results, options, count, advance)
        except KeyboardInterrupt as interrupt:
            raise RegistrationInterrupted(results) from interrupt
    return [result for result in results if result is not None]


def _run_here(
    todo: list[Any],
    results: list[Outcome | None],
    options: dict[str, Any],
    count: int,
    advance: Callable[[], None],
) -> None:
    for index, pair in enumerate(todo):
        results[index] = _outcome(pair, options)
        advance()


def _run_workers(
    todo: list[Any],
    results: list[Outcome | None],
    options: dict[str, Any],
    count: int,
    advance: Callable[[], None],
) -> None:
    """Hand one pair at a time to each idle worker; replace a worker that dies."""
    crew: dict[Connection, _Worker] = {}
    waiting = iter(range(len(todo)))

    def finish(index: int, outcome: Outcome) -> None:
        results[index] = outcome
        advance()

    def feed(worker: _Worker) -> None:
        for index in waiting:
            try:
                worker.give(index, _portable(todo[index]))
            except FullturnError as error:
                finish(index, error)
            else:
                return
        crew.pop(worker.pipe).stop()

    try:
        for _ in range(count):
            worker = _Worker(options)
            crew[worker.pipe] = worker
        while crew:
            for pipe in wait(list(crew)):
                worker = crew[pipe]  # type: ignore[index]
                try:
                    outcome = worker.pipe.recv()
                except (EOFError, OSError):
                    del crew[worker.pipe]
                    worker.stop()
                    if worker.index is None:
                        raise FullturnError(
                            "worker processes cannot start: call register_many from under "
                            '`if __name__ == "__main__":`, or with workers=1'
                        ) from None
                    finish(worker.index, _died(worker))
                    replacement = _Worker(options)
                    crew[replacement.pipe] = replacement
                    continue
                if worker.index is not None:
                    finish(worker.index, outcome)
                feed(worker)
    finally:
        for worker in crew.values():
            worker.stop()


def check_seed(seed: Any) -> int:
    """The seed as an int.

    Raises:
        InputError: not a whole number of at least 0.
    """
    try:
        number = operator.index(seed)
    except TypeError:
        number = -1
    if number < 0 or isinstance(seed, bool):
        raise InputError(f"seed: expected a whole number of at least 0, got {seed!r:.80}")
    return number


class _Worker:
    """One process that says it is ready, then answers one pair after the other."""

    def __init__(self, options: dict[str, Any]) -> None:
        context = multiprocessing.get_context("spawn")
        self.index: int | None = None  # of the pair at work
        self.pipe, other = context.Pipe()
        self.process = context.Process(target=_work, args=(other, options), daemon=True)
        try:
            self.process.start()
        except RuntimeError as error:  # this is itself a process that is still starting
            raise FullturnError(
                "worker processes cannot start: call register_many from under "
                '`if __name__ == "__main__":`, or with workers=1'
            ) from error
        other.close()

    def give(self, index: int, pair: Any) -> None:
        try:
            self.pipe.send(pair)
        except (BrokenPipeError, ConnectionError):
            pass  # the worker died; reading from it says so
        # Pickling an unknown object raises whatever that object raises.
        except Exception as error:
            raise InputError(
                f"expected clouds that can be sent to a worker process, got one that cannot "
                f"({one_line(error)[:120]}); give arrays or file paths"
            ) from error
        self.index = index

    def stop(self) -> None:
        self.pipe.close()
        self.process.terminate()
        self.process.join()


def _work(pipe: Connection, options: dict[str, Any]) -> None:
    import signal

    # Ctrl-C reaches the whole group; the parent decides what becomes of its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    pipe.send("ready")
    while True:
        try:
            pair = pipe.recv()
        except EOFError:
            return
        pipe.send(_outcome(pair, options))


def _outcome(pair: Any, options: dict[str, Any]) -> Outcome:
    from fullturn.api import register

    try:
        source, target = _portable(pair)
        return register(source, target, **options)
    except FullturnError as error:
        return error.with_traceback(None)  # whose frames would keep the clouds in memory
    # A fault in one pair must not cost the others their results.
    except Exception as error:
        return FullturnError(f"unexpected {type(error).__name__}: {one_line(error)}")


def _two(pair: Any) -> tuple[Any, Any]:
    try:
        source, target = pair
    except (TypeError, ValueError) as error:
        raise InputError(
            f"expected a (source, target) pair, got a {type(pair).__name__}; give two clouds"
        ) from error
    return source, target


def _portable(pair: Any) -> tuple[Any, Any]:
    """The pair as something that can be sent: paths as they are, objects as loaded clouds."""
    source, target = _two(pair)
    source = source if isinstance(source, (str, os.PathLike)) else load_cloud(source, name="source")
    target = target if isinstance(target, (str, os.PathLike)) else load_cloud(target, name="target")
    return source, target


def _died(worker: _Worker) -> FullturnError:
    return FullturnError(
        f"the worker process ended without an answer (exit code {worker.process.exitcode}); "
        "there may be too little memory for this pair: use fewer workers"
    )


def _cpus() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class _Progress:
    """A progress bar on standard error, or nothing."""

    def __init__(self, total: int, *, shown: bool) -> None:
        self.total, self.bar = total, None
        if shown:
            from rich.console import Console
            from rich.progress import Progress

            self.bar = Progress(console=Console(stderr=True))

    def __enter__(self) -> Callable[[], None]:
        if self.bar is None:
            return lambda: None
        bar = self.bar
        bar.start()
        task = bar.add_task("registering", total=self.total)
        return lambda: bar.advance(task)

    def __exit__(self, *error: object) -> None:
        if self.bar is not None:
            self.bar.stop()
