"""`fullturn freeze`: write the pairs of a set to one file that keeps them for good."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def freeze(
    out: Annotated[Path, typer.Option(help="File to write: .npz.")],
    protocol: Annotated[
        str | None, typer.Option(help="A protocol, for example modelnet40/noisy/180.")
    ] = None,
    shapes: Annotated[
        str | None,
        typer.Option(
            metavar="SPEC",
            help="FILE.npz[:PART], a folder of meshes or of ModelNet40 HDF5 files, or "
            "procedural[:COUNT[:SEED]].",
        ),
    ] = None,
    count: Annotated[int, typer.Option(min=1, help="Pairs to make.")] = 300,
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same pairs.")] = 0,
    pairs: Annotated[
        str | None,
        typer.Option(
            metavar="PATH",
            help="Pairs as they are, instead: a folder of scans with poses, a published .h5 test "
            "file, a frozen .npz file.",
        ),
    ] = None,
) -> None:
    """Make pairs by a protocol, or read them, and write them to a file with their hash.

    A path that doesn't exist here is looked for below the environment variable FULLTURN_DATA.
    """
    if (protocol is None) != (shapes is None) or (protocol is None) == (pairs is None):
        raise typer.BadParameter("expected --protocol with --shapes, or --pairs alone")

    from fullturn.cli.outputs import check_outputs
    from fullturn.data.frozen import freeze as write
    from fullturn.data.open import open_pairs, open_shapes, place_of, protocol_pairs

    check_outputs((out, (".npz",)), inputs=(place_of(shapes), place_of(pairs)))

    if pairs is not None:
        made = open_pairs(pairs)
    else:
        if protocol == "all":
            raise typer.BadParameter("--protocol: expected one protocol, got all")
        source = open_shapes(str(shapes))
        made = protocol_pairs([str(protocol)], source, count=count, seed=seed)[0][0]
    manifest = write(made, out)
    typer.echo(f"{out}: {manifest['count']} pairs of {manifest['name']}")
    typer.echo(f"sha256 of the pairs: {manifest['sha256']}")
