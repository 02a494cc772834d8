"""A client of Dask: of processes started here, or of the scheduler at an address."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TYPE_CHECKING

from fullturn.errors import DependencyError, FullturnError, InputError, one_line
from fullturn.workers import interrupts_held, one_thread_each

if TYPE_CHECKING:
    from distributed import Client

_CONNECT_SECONDS = 15.0
# With another text, Dask's half-made client keeps the process for half a minute.
_ADDRESS = re.compile(r"(\w+://)?\S+:\d+")


def check_installed() -> None:
    """Say what is missing, before any work.

    Raises:
        DependencyError: a package of the extra `cluster` isn't there.
    """
    missing = [name for name in ("distributed", "pyarrow") if find_spec(name) is None]
    if missing:
        raise DependencyError(
            f"a batch expects {' and '.join(missing)}, not installed; "
            'install it with pip install "fullturn[cluster]"'
        )


@contextmanager
def connected(scheduler: str | None, *, workers: int) -> Iterator[Client]:
    """A client, closed at the end; without `scheduler`, so are `workers` processes started here.

    Raises:
        InputError: nothing answers at this address, or it is none.
        FullturnError: worker processes cannot start.
    """
    with _quiet(), _address(scheduler, workers=workers) as address, _client(address) as client:
        yield client


@contextmanager
def _address(scheduler: str | None, *, workers: int) -> Iterator[str]:
    if scheduler is not None:
        yield scheduler
        return
    with _local_cluster(workers) as address:
        yield address


def _client(address: str) -> Client:
    from distributed import Client

    try:
        if not _ADDRESS.fullmatch(address):
            raise ValueError("no host and port")
        return Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
    # What is no address at all ends in whatever the parser of addresses raises.
    except Exception as error:
        raise InputError(
            f"scheduler: expected the address of a Dask scheduler as tcp://HOST:8786, got "
            f"{one_line(address)[:200]}, where none can be reached ({one_line(error)[:200]}); "
            "check that it runs"
        ) from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Dask says on standard error that a worker is lost, which is no news to a run that goes on."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


@contextmanager
def _local_cluster(workers: int) -> Iterator[str]:
    """Processes of one thread each; a worker that dies is started again."""
    import dask
    from distributed import LocalCluster

    settings = {
        # Dask needn't try again by itself: what goes with a worker is sent again pair by pair.
        "distributed.scheduler.allowed-failures": 0,
        # Giving memory back to the system all the time costs half as much CPU time again.
        "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
        "distributed.worker.profile.enabled": False,  # nobody would see it
    }
    with one_thread_each(), dask.config.set(settings):
        try:
            with interrupts_held():  # also what Dask's own thread starts later
                cluster = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    # No dashboard; but a port is opened all the same: 8787 may be another run's.
                    scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
                    silence_logs=logging.CRITICAL,
                    preload=["fullturn.cluster.preload"],
                )
        except RuntimeError as error:
            raise FullturnError(
                "worker processes cannot start: call this from under "
                f'`if __name__ == "__main__":` ({one_line(error)[:200]})'
            ) from error
        with cluster:
            yield cluster.scheduler_address
