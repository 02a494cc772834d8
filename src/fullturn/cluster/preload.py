"""What Dask loads first in the worker processes that a batch starts itself."""

from __future__ import annotations

import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Leave Ctrl-C to the process that started this one: a terminal sends it to both.

    Dask calls it by this name, in the main thread.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
