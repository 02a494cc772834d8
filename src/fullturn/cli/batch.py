"""`fullturn batch PAIRS.csv`: register a table of pairs on a cluster, or on this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fullturn.cli.errors import tell

_REASONS = 5  # of failed pairs, told at the end


def batch(
    pairs: Annotated[
        Path,
        typer.Argument(
            metavar="PAIRS.csv", help="Table with the columns source and target: a pair a row."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder of results; made if missing.")],
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Dask scheduler; else processes started here."),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes started here; else one per CPU.")
    ] = None,
    method: Annotated[str, typer.Option(help="See `fullturn methods`.")] = "auto",
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same results.")] = 0,
    part_size: Annotated[int, typer.Option(min=1, help="Pairs in each file of results.")] = 20,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Do files of results with failed pairs again.")
    ] = False,
) -> None:
    """Register all pairs of a table and write one row of results for each, as Parquet.

    A run that was interrupted goes on where it was when it is started again. A pair that can't be
    registered is a row with its reason.

    Exit codes: 0 every pair has its row, failed ones included; 1 error, 2 wrong usage, 130
    interrupted.
    """
    if scheduler is not None and workers is not None:
        raise typer.BadParameter("--workers and --scheduler: expected at most one of them")

    from fullturn.cluster.client import check_installed

    check_installed()  # quick, before torch is loaded

    from fullturn.cluster.run import run_batch

    summary = run_batch(
        pairs,
        out=out,
        scheduler=scheduler,
        workers=workers,
        method=method,
        seed=seed,
        part_size=part_size,
        retry_failed=retry_failed,
        progress=True,
        note=tell,
    )
    for number, (name, reason) in enumerate(summary.failures):
        if number == _REASONS:
            typer.echo(f"… and {len(summary.failures) - _REASONS:,} more")
            break
        typer.echo(f"failed: {name}: {reason}")
    earlier = f", {summary.found:,} of them by an earlier run" if summary.found else ""
    typer.echo(
        f"{summary.done:,} done, {len(summary.failures):,} failed{earlier}; "
        f"{summary.seconds:.1f} s; results in {summary.folder}"
    )
