"""`fullturn fuse SCANS…`: many scans of an object become one cloud."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fullturn.cli.errors import tell
from fullturn.cli.minimum import check_minimum

if TYPE_CHECKING:
    import numpy as np

    from fullturn.fusion.result import Fusion


def fuse(
    scans: Annotated[
        list[Path], typer.Argument(metavar="SCANS…", help="Clouds or meshes, in any order.")
    ],
    out: Annotated[
        Path, typer.Option(help="Write the merged cloud: .ply, .npy, .xyz, .txt or .csv.")
    ],
    poses: Annotated[
        Path | None, typer.Option(help="Write every scan's pose, probability and group: .json.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Write a report: one self-contained .html file.")
    ] = None,
    viewpoints: Annotated[
        Path | None,
        typer.Option(help="Where the sensors stood: a text file, per scan a line x y z, or -."),
    ] = None,
    method: Annotated[str, typer.Option(help="See `fullturn methods`.")] = "auto",
    min_probability: Annotated[
        float, typer.Option(min=0.01, max=1.0, help="Join what is at least so probable.")
    ] = 0.8,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; else one per CPU.")] = None,
    cache: Annotated[
        Path | None, typer.Option(help="Folder for finished pairs; a stopped run goes on there.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same result.")] = 0,
    json: Annotated[
        bool, typer.Option("--json", help="Print the result as one JSON object.")
    ] = False,
) -> None:
    """Find the poses of many scans of one object and merge them.

    Scans that nothing firmly connects stay in groups of their own: --out gets the largest, every
    other group of two or more scans a file beside it (merged_group2.ply, …).

    Exit codes: 0 fused, into one group or several; 1 error, 2 wrong usage.
    """
    from fullturn.cli.outputs import check_outputs
    from fullturn.io.save import CLOUD_SUFFIXES, save_cloud

    check_minimum(min_probability)

    others = [_of_group(out, number) for number in range(2, len(scans) // 2 + 1)]
    check_outputs(
        (out, CLOUD_SUFFIXES),
        (poses, (".json",)),
        (report, (".html", ".htm")),
        *((path, CLOUD_SUFFIXES) for path in others),
        inputs=(*scans, viewpoints),
    )
    eyes = None if viewpoints is None else _read_viewpoints(viewpoints, len(scans))

    from json import dumps

    from fullturn.fusion.fuse import fuse as run
    from fullturn.io.atomic import write_atomic

    fusion = run(
        scans,
        viewpoints=eyes,
        method=method,
        seed=seed,
        min_probability=min_probability,
        workers=workers,
        cache=cache,
        progress=True,
    )
    written = {out: fusion.points}
    for number, group in enumerate(fusion.groups[1:], start=2):
        if len(group) > 1:
            written[_of_group(out, number)] = fusion.merged[number - 1].points
    for path, points in written.items():
        save_cloud(path, points)
    for path in others:
        if path not in written and path.exists():
            tell(f"note: {path} was there before and is none of these groups")
    content = _content(fusion, [str(scan) for scan in scans])
    if poses is not None:
        write_atomic(poses, dumps(content, indent=1) + "\n")
    if report is not None:
        from fullturn.fusion.report import write_fusion_report

        write_fusion_report(report, scans, fusion)
    if json:
        print(dumps({**content, "written": [str(path) for path in written]}))
    else:
        _print_table(fusion, written)


def _of_group(out: Path, number: int) -> Path:
    return out.with_name(f"{out.stem}_group{number}{out.suffix}")


def _read_viewpoints(path: Path, count: int) -> list[tuple[float, ...] | None]:
    """One place for each of `count` lines that aren't empty, None for one that is a hyphen."""
    from fullturn.errors import ReadError
    from fullturn.io.text import encoding_of, three_numbers

    try:
        data = path.read_bytes()
        lines = data.decode(encoding_of(data)).splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ReadError(f"cannot read the viewpoints {path}: {error}; check the file") from error
    places: list[tuple[float, ...] | None] = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        is_unknown = line.strip() == "-"
        place = None if is_unknown else three_numbers(line)
        if place is None and not is_unknown:
            raise ReadError(
                f"{path}, line {number}: expected three numbers as in 0.1 -2 3, or -, got "
                f"{line[:80]!r}; change the line"
            )
        places.append(place)
    if len(places) != count:
        raise ReadError(
            f"{path}: expected a line for each of {count} scans, got {len(places)}; write - where "
            "a sensor's place isn't known"
        )
    return places


def _content(fusion: Fusion, paths: list[str]) -> dict[str, Any]:
    """A fusion as JSON can hold it: NaN and what is left out are null."""
    return {
        "scans": [
            {
                "path": path,
                "group": None if group < 0 else group,
                "T_world_scan": None if T is None else T.tolist(),
                "probability": None if math.isnan(p) else p,
                "covariance": None if C is None else C.tolist(),
            }
            for path, group, T, p, C in zip(
                paths,
                fusion.group,
                fusion.T_world_scan,
                fusion.probability,
                fusion.covariance,
                strict=True,
            )
        ],
        "groups": [[paths[scan] for scan in group] for group in fusion.groups],
        "edges": [
            {
                "target": paths[edge.target],
                "source": paths[edge.source],
                "target_scans": [paths[scan] for scan in edge.target_scans],
                "source_scans": [paths[scan] for scan in edge.source_scans],
                "probability": list(edge.probability),
                "chosen": None if edge.chosen < 0 else edge.chosen,
                "overlap": list(edge.overlap),
                "error": edge.error,
            }
            for edge in fusion.edges
        ],
        "points": len(fusion.points),
        "method": fusion.method,
        "seconds": fusion.seconds,
        "notes": list(fusion.notes),
    }


def _print_table(fusion: Fusion, written: dict[Path, np.ndarray]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from fullturn.fusion.report import deviation, rotation_sigma_deg
    from fullturn.viz.tables import probability

    table = Table(box=None, pad_edge=False)
    table.add_column("scan", overflow="fold")
    for title in ("group", "probability", "± °", "pairs"):
        table.add_column(title, justify="right")
    for number, (name, group) in enumerate(zip(fusion.names, fusion.group, strict=True)):
        pairs = sum(e.chosen >= 0 and number in (e.target, e.source) for e in fusion.edges)
        sigma = rotation_sigma_deg(fusion, number)
        alone = group >= 0 and len(fusion.groups[group]) == 1
        table.add_row(
            Text(name),  # a name may hold brackets that are no markup
            str(group + 1) if group >= 0 else "left out",
            "" if group < 0 else "alone" if alone else probability(fusion.probability[number]),
            deviation(sigma),
            str(pairs),
        )
    console = Console()
    console.print(table)
    for note in fusion.notes:
        console.print(Text(f"note: {note}"))
    files = ", ".join(map(str, written))
    count = sum(map(len, written.values()))
    console.print(Text(f"{count:,} points in {files}; {fusion.seconds['total']:.1f} s"))
