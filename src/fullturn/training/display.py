"""How a run goes, on standard error: a bar and a table on a terminal, lines anywhere else."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from fullturn.training.config import TrainConfig
from fullturn.training.loop import Watcher
from fullturn.training.run import Silence
from fullturn.training.validation import Score

_ROWS = 8  # validations in the table
_MEMORY = 0.98  # of the running mean of the loss


@contextmanager
def live_display(config: TrainConfig, console: Console | None = None) -> Iterator[Watcher]:
    """A watcher that shows a run; the other processes of a shared run show nothing."""
    if os.environ.get("RANK", "0") != "0":
        yield Silence()
        return
    console = console or Console(stderr=True)
    display = _Display(config, console)
    if not console.is_terminal:
        yield display
        return
    with Live(get_renderable=display.view, console=console, refresh_per_second=4):
        yield display


class _Display:
    def __init__(self, config: TrainConfig, console: Console) -> None:
        self._console = console
        self._bar = Progress(
            TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[text]}"),
            TimeRemainingColumn(), console=console, auto_refresh=False,
        )  # fmt: skip
        self._task = self._bar.add_task(config.name, total=None, text="")
        self._scores: list[tuple[Score, bool]] = []
        self._loss: float | None = None
        self._start: tuple[float, int] | None = None  # seconds and pairs at the first step seen

    def start(self, step: int, *, total: int | None) -> None:
        self._bar.update(self._task, total=total, completed=step)

    def step(self, step: int, *, loss: float, seconds: float, pairs: int) -> None:
        self._loss = loss if self._loss is None else _MEMORY * self._loss + (1 - _MEMORY) * loss
        self._start = self._start or (seconds, pairs)
        passed = seconds - self._start[0]
        rate = f"{(pairs - self._start[1]) / passed:.1f} pairs/s" if passed > 0.0 else ""
        text = f"step {step:,}  loss {self._loss:.4f}  {rate}"
        self._bar.update(self._task, completed=step, text=text)

    def score(self, score: Score, *, is_best: bool) -> None:
        self._scores = [*self._scores, (score, is_best)][-_ROWS:]
        if not self._console.is_terminal:
            loss = "" if self._loss is None else f"loss {self._loss:.4f}, "
            self._console.print(
                f"step {score.step}: {loss}validation mean {score.mean_deg:.2f}°, median "
                f"{score.median_deg:.2f}°, below 1° {score.below_1:.2f}, below 5° "
                f"{score.below_5:.2f}{', best so far' if is_best else ''}",
                highlight=False,
                soft_wrap=True,
            )

    def view(self) -> Group:
        """The table of the last validations above the bar."""
        table = Table("step", "mean", "median", "below 1°", "below 5°", "", box=None)
        for score, is_best in self._scores:
            table.add_row(
                f"{score.step:,}",
                f"{score.mean_deg:.2f}°",
                f"{score.median_deg:.2f}°",
                f"{score.below_1:.2f}",
                f"{score.below_5:.2f}",
                "best so far" if is_best else "",
            )
        return Group(table, self._bar) if self._scores else Group(self._bar)
