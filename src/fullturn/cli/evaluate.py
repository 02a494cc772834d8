"""`fullturn evaluate`: measure methods on sets of pairs and write a run folder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fullturn.cli.errors import tell


def evaluate(
    out: Annotated[Path, typer.Option(help="Run folder; made if missing.")],
    method: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME …", help="Methods; see `fullturn methods`, or file.py:Class."),
    ] = None,
    protocol: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME …", help='Protocols, or "all" that the shapes can serve.'),
    ] = None,
    shapes: Annotated[
        str | None,
        typer.Option(
            metavar="SOURCE",
            help="Where protocols take shapes from: a pack FILE.npz[:PART], a folder of meshes, a "
            "modelnet40_ply_hdf5_2048 folder, or procedural[:COUNT[:SEED]].",
        ),
    ] = None,
    pairs: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATH …",
            help="Pairs as they are: frozen .npz, published .h5, or a folder of range scans.",
        ),
    ] = None,
    blind: Annotated[
        bool,
        typer.Option(
            "--blind",
            help="Don't tell methods where sensors stood, nor how far scans may be turned.",
        ),
    ] = False,
    count: Annotated[int, typer.Option(min=1, help="Pairs of each protocol.")] = 300,
    seed: Annotated[int, typer.Option(min=0, help="Of the pairs and of the methods.")] = 0,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes of one thread each; default: all CPUs.")
    ] = None,
    cache: Annotated[
        Path, typer.Option(help="Folder of predictions, so that nothing is computed twice.")
    ] = Path(".fullturn-cache"),
) -> None:
    """Predict, score and sum up: every METHOD on every PROTOCOL and on all PAIRS.

    Writes summary.json, timing.json and pairs/*.csv; `fullturn table` makes tables and figures of
    them. A run that was interrupted goes on where it was when it is started again.
    """
    if not method:
        raise typer.BadParameter("--method: expected at least one; see `fullturn methods`")
    if bool(protocol) != bool(shapes):
        raise typer.BadParameter("--protocol and --shapes: expected both or none of them")
    if not protocol and not pairs:
        raise typer.BadParameter("expected --protocol with --shapes, or --pairs")

    from fullturn.cli.render import print_results
    from fullturn.data.hidden import BlindPairs
    from fullturn.data.open import open_pairs, open_shapes, protocol_pairs
    from fullturn.data.pair_set import PairSet
    from fullturn.evaluation.folders import read_runs
    from fullturn.evaluation.run import evaluate as run
    from fullturn.evaluation.tables import main_table
    from fullturn.progress import progress_bar
    from fullturn.workers import check_workers

    sets: list[PairSet] = []
    if protocol and shapes:
        sets, left_out = protocol_pairs(protocol, open_shapes(shapes), count=count, seed=seed)
        for line in left_out:
            tell(f"left out: {line}")
    sets += [open_pairs(path) for path in pairs or ()]
    if blind:
        sets = [BlindPairs(one) for one in sets]
    total = len(method) * sum(len(one) for one in sets)
    with progress_bar("predicting", total) as advance:
        run(
            sets,
            method,
            out=out,
            cache=cache,
            seed=seed,
            workers=check_workers(workers),
            advance=advance,
            note=tell,
        )
    print_results(main_table(read_runs([out])))
    typer.echo(f"Written to {out}; tables and figures: fullturn table {out} --out DIR")
