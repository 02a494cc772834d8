"""Many pairs over the processes of a Dask cluster, results as Parquet."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__all__ = ["BatchSummary", "run_batch"]

if TYPE_CHECKING:
    from fullturn.cluster.run import BatchSummary, run_batch


def __getattr__(name: str) -> Any:
    # Lazy: the command line asks for its options before it needs torch or Dask.
    if name in __all__:
        from fullturn.cluster import run

        return getattr(run, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
