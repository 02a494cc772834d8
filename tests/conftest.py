"""In the test run, calls in all rooms that compute are checked: types and tensor shapes."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest
from hypothesis import settings
from jaxtyping import config, install_import_hook

ROOMS = (
    *("geometry", "features", "nn", "matching", "pose", "normalize", "data", "training"),
    "evaluation",
    *("methods.consensus", "methods.classical", "methods.external", "methods.learned"),
    *("methods.check", "methods.own"),
    "locating",
    *(f"fusion.{name}" for name in ("likely", "joint", "graph", "optimize", "rivals", "settle")),
    *(f"fusion.{name}" for name in ("sight", "whole", "merge", "connect", "edges", "scans")),
)

# The others are not: the front door, the files and the command line answer wrong types themselves,
# by named errors; figures and the runs of many pairs move what was computed elsewhere.
install_import_hook([f"fullturn.{room}" for room in ROOMS], "type_checks.checked")


# How long an example takes says how busy the machine is.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.fixture
def unchecked() -> Iterator[None]:
    """Without the type checks: for tests of what the package itself says about wrong shapes."""
    config.update("jaxtyping_disable", True)
    yield
    config.update("jaxtyping_disable", False)


@pytest.fixture(scope="session", autouse=True)
def _interrupts_arrive() -> None:
    """A run in the background ignores SIGINT, and so would the processes that tests interrupt."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
