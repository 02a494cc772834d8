"""A progress bar on standard error."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress_bar(label: str, total: int, *, shown: bool = True) -> Iterator[Callable[[int], None]]:
    """Give a function that counts finished work up to `total`; without `shown`, nothing is drawn.

    >>> with progress_bar("registering", 10, shown=False) as advance:
    ...     advance(3)
    """
    if not shown:
        yield lambda count: None
        return
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress

    columns = (*Progress.get_default_columns(), MofNCompleteColumn())
    bar = Progress(*columns, console=Console(stderr=True))
    task = bar.add_task(label, total=total)

    def advance(count: int) -> None:
        bar.start()  # only now, so that an error at the start stands alone
        bar.advance(task, count)

    try:
        yield advance
    finally:
        bar.stop()
