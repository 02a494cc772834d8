"""Many registrations at once, in worker processes; none of them stops the others."""

from __future__ import annotations

import os
from collections.abc import Iterable
from functools import partial
from typing import Any

from fullturn.errors import FullturnError, InputError, whole_number
from fullturn.io.load import load_cloud
from fullturn.methods.check import check_max_rotation, make_method
from fullturn.progress import progress_bar
from fullturn.result import Registration
from fullturn.workers import Crew, attempt, check_workers

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
    max_rotation_deg: float | None = None,
    workers: int | None = None,
    progress: bool = False,
) -> list[Outcome]:
    """Register every (source, target) pair; a pair that fails becomes its error in the list.

    The results are those of `register(source, target, …)` with the same `method`, `seed` and
    `max_rotation_deg`, bit for bit, for any number of workers. `workers` defaults to the number of
    CPUs; 1 stays in this process.
    Workers start afresh ("spawn"): a script calls this from under ``if __name__ == "__main__":``.

    Raises:
        InputError: `pairs`, `method`, `seed`, `max_rotation_deg` or `workers` cannot be used at
            all.
        DependencyError: the method's package is missing.
        FullturnError: worker processes cannot start.
        RegistrationInterrupted: Ctrl-C; it carries the finished results.
    """
    solver = make_method(method)  # says now, and not once per pair, that a package is missing
    whole_number(seed, "seed", least=0)
    check_max_rotation(max_rotation_deg, type(solver))
    if isinstance(pairs, (str, bytes)) or not isinstance(pairs, Iterable):
        raise InputError(
            f"pairs: expected (source, target) pairs, got a {type(pairs).__name__}; give a list"
        )
    most = check_workers(workers)
    todo = list(pairs)
    results: list[Outcome | None] = [None] * len(todo)
    work = partial(_register_pair, method=method, seed=seed, max_rotation_deg=max_rotation_deg)
    with progress_bar("registering", len(todo), shown=progress) as advance:

        def done(number: int, outcome: Outcome) -> None:
            results[number] = outcome
            advance(1)

        try:
            if min(most, len(todo)) <= 1:
                for number, pair in enumerate(todo):
                    done(number, attempt(work, pair))
            else:
                with Crew(work, workers=min(most, len(todo))) as crew:
                    crew.run(todo, done, portable=_portable)
        except KeyboardInterrupt as interrupt:
            raise RegistrationInterrupted(results) from interrupt
    return [result for result in results if result is not None]


def _register_pair(pair: Any, **options: Any) -> Registration:
    from fullturn.api import register

    source, target = _portable(pair)
    return register(source, target, **options)


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
