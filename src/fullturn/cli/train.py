"""`fullturn train RECIPE`: train the network as a recipe says."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fullturn.cli.errors import tell


def train(
    recipe: Annotated[
        str,
        typer.Argument(
            metavar="RECIPE", help="FILE.toml, or FILE.toml:word,word… where it offers words."
        ),
    ],
    settings: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[KEY=VALUE]…",
            help="On top of the recipe, such as data.batch=8.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Run folder; default: runs/ and the name of the run.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the run in the folder, to the bit.")
    ] = False,
    data: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            file_okay=False,
            help="Folder of data; default: as written, then the variable FULLTURN_DATA.",
        ),
    ] = None,
    show: Annotated[
        bool, typer.Option("--show", help="Print the whole recipe as TOML, and stop.")
    ] = False,
) -> None:
    """Train, validate, save: weights.safetensors with a card, logs, curves and checkpoints.

    Ctrl-C ends a run after the step at work; --resume goes on from there. On several GPUs:
    torchrun --nproc-per-node N --no-python fullturn train RECIPE.
    """
    from fullturn.training.recipe import load_recipe
    from fullturn.training.strict import to_table, to_toml

    config = load_recipe(recipe, settings or [])
    if show:
        typer.echo(to_toml(to_table(config)), nl=False)
        return

    from fullturn.cli.errors import INTERRUPTED
    from fullturn.training.display import live_display
    from fullturn.training.run import train as run
    from fullturn.training.signals import until_interrupted

    place = out or Path("runs") / config.name
    with live_display(config) as watcher, until_interrupted() as stop:
        done = run(
            config, out=place, resume=resume, data=data, watcher=watcher, stop=stop, note=tell
        )
    if not done.is_finished:
        tell(f"stopped after step {done.step}; go on with --resume --out {place}")
        raise typer.Exit(INTERRUPTED)
    typer.echo(f"Written to {place}: weights.safetensors, its card weights.md, and loss.png")
