"""`fullturn build mvp-rg`: make a dataset of partial views from meshes."""

from __future__ import annotations

from collections import Counter
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fullturn.cli.sensor import Flying, Grazing, Holes, Noise, Quantize

if TYPE_CHECKING:
    from collections.abc import Iterable

    from fullturn.data.mvp_build import Done
    from fullturn.data.mvp_pair import PairMaker, Task
    from fullturn.data.shapes import MeshSource


class DataSet(StrEnum):
    """What can be built."""

    MVP_RG = "mvp-rg"


class Rotation(StrEnum):
    """How far the two clouds of a pair are turned."""

    FULL = "full"
    RELEASED = "released"


def build(
    what: Annotated[DataSet, typer.Argument(help="The dataset.")],
    shapes: Annotated[
        list[str],
        typer.Option(
            metavar="SOURCE …",
            help="Meshes: a pack FILE.npz[:PART], a folder, or procedural[:COUNT[:SEED]].",
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the shards; made if missing.")],
    test_shapes: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SOURCE …",
            help="Meshes to test on; without, a fifth of the shapes is kept for testing.",
        ),
    ] = None,
    train: Annotated[int, typer.Option(min=0, help="Pairs to train on.")] = 6400,
    test: Annotated[int, typer.Option(min=0, help="Pairs to test on.")] = 1200,
    rotation: Annotated[
        Rotation,
        typer.Option(help="Any rotation, or four of five within 45° as in the published set."),
    ] = Rotation.FULL,
    min_overlap: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Least overlap of the two views.")
    ] = 0.3,
    noise: Noise = 0.0,
    quantize: Quantize = 0.0,
    grazing: Grazing = 0.0,
    flying: Flying = 0.0,
    holes: Holes = 0,
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same bytes.")] = 0,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes of one thread each; default: all CPUs.")
    ] = None,
) -> None:
    """Make pairs of virtual scans: 26 depth cameras around each object, 2,048 farthest points.

    Writes shards of pairs and, at the end, manifest.json with their hashes and all that was left
    out. A build that was interrupted goes on where it was when it is started again; the files are
    the same for any number of workers. See docs/mvp-rg.md.
    """
    from fullturn.data.mvp_build import build_mvp_rg
    from fullturn.data.mvp_rg import MvpRgConfig
    from fullturn.data.sensor import Sensor
    from fullturn.progress import progress_bar
    from fullturn.workers import Crew, check_workers

    count = check_workers(workers)

    def run(work: PairMaker, tasks: Iterable[Task], done: Done) -> None:
        with Crew(work, workers=count) as crew:
            crew.run(tasks, done)

    config = MvpRgConfig(
        train=train,
        test=test,
        rotation=rotation.value,
        min_overlap=min_overlap,
        seed=seed,
        sensor=Sensor(
            noise=noise, quantize=quantize, grazing_deg=grazing, flying=flying, holes=holes
        ),
    )
    sources = [_meshes(spec) for spec in shapes]
    test_sources = [_meshes(spec) for spec in test_shapes or ()]
    with progress_bar(f"building {what.value}", train + test) as advance:
        manifest = build_mvp_rg(
            sources, out, config, test_shapes=test_sources, run=run, advance=advance
        )
    parts = [
        f"{part['count']} {split} pairs of {part['shapes_used']} shapes"
        for split, part in manifest["splits"].items()
        if part["count"]
    ]
    typer.echo(f"{out}: {', '.join(parts)}; left out: {_left_out(manifest['splits'])}")


def _meshes(spec: str) -> MeshSource:
    from fullturn.data.open import open_shapes
    from fullturn.data.shapes import MeshSource
    from fullturn.errors import InputError

    source = open_shapes(spec)
    if not isinstance(source, MeshSource):
        raise InputError(
            f"expected meshes, which a camera can see, got stored points in {spec}; "
            "pass a mesh pack, a folder of meshes or procedural"
        )
    return source


def _left_out(splits: dict[str, dict[str, dict[str, int]]]) -> str:
    """How often each reason to leave something out came up."""
    total = sum((Counter(part["skips"]) for part in splits.values()), Counter[str]())
    return ", ".join(f"{count} × {reason}" for reason, count in sorted(total.items())) or "nothing"
