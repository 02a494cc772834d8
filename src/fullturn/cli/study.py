"""`fullturn study NAME`: repeat a study of the paper on any shapes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

STUDIES = ("robustness",)


def study(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Which study: robustness.")],
    shapes: Annotated[
        str,
        typer.Option(
            metavar="SPEC",
            help="FILE.npz[:PART], a folder of meshes, or procedural[:COUNT[:SEED]].",
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for what is written; made if missing.")],
    count: Annotated[
        int, typer.Option(min=1, help="Shapes, evenly spread where there are more.")
    ] = 100,
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same numbers.")] = 0,
    neighbors: Annotated[int, typer.Option(min=2, help="Per point, itself included.")] = 8,
    jitter: Annotated[
        float,
        typer.Option(
            min=0.0, help="Noise on what is read, in its unit; 1e-5 parts points on a lattice."
        ),
    ] = 0.0,
) -> None:
    """Measure how handcrafted features change under rotation, translation and noise.

    Writes robustness.csv, and robustness.png where matplotlib is installed.
    """
    if name not in STUDIES:
        raise typer.BadParameter(f"NAME: expected one of {', '.join(STUDIES)}; got {name!r}")

    from fullturn.cli.render import draw
    from fullturn.data.open import open_shapes
    from fullturn.evaluation.robustness import StudyConfig, by_panel, study_robustness, to_csv
    from fullturn.io.atomic import make_folder, write_atomic
    from fullturn.progress import progress_bar
    from fullturn.viz.robustness import save_robustness

    source = open_shapes(shapes)
    config = StudyConfig(neighbors=neighbors, jitter=jitter)
    make_folder(out)
    total = min(count, len(source))
    with progress_bar("shapes", total) as advance:
        rows = study_robustness(
            source, count=count, seed=seed, config=config, on_shape=lambda *_: advance(1)
        )
    write_atomic(out / "robustness.csv", to_csv(rows))
    typer.echo(f"{total} shapes: {out / 'robustness.csv'}")
    draw(out / "robustness.png", lambda path: save_robustness(path, by_panel(rows)))
