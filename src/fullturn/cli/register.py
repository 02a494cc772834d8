"""`fullturn register SOURCE TARGET`: the pose of one file's cloud in the frame of another's."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fullturn.cli.minimum import check_minimum, exit_if_below
from fullturn.cli.outputs import PICTURE_SUFFIXES, check_outputs
from fullturn.cli.viewpoint import parse_viewpoint


def register(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="Cloud or mesh that is to be moved.")
    ],
    target: Annotated[
        Path, typer.Argument(metavar="TARGET", help="Cloud or mesh in whose frame it will stand.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="Write the 4×4 transform: .txt or .json.")
    ] = None,
    json: Annotated[
        bool, typer.Option("--json", help="Print the result as one JSON object.")
    ] = False,
    save: Annotated[
        Path | None, typer.Option(help="Write the moved source: .ply, .npy, .xyz, .txt or .csv.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Write a report: one self-contained .html file.")
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option(help="Draw the clouds before and after: .png, .pdf, .svg or .jpg."),
    ] = None,
    method: Annotated[str, typer.Option(help="See `fullturn methods`.")] = "auto",
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same result.")] = 0,
    min_probability: Annotated[
        float | None,
        typer.Option(min=0.0, max=1.0, help="Exit with 3 if the probability is below this."),
    ] = None,
    source_viewpoint: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Where the sensor stood, in SOURCE's frame.")
    ] = None,
    target_viewpoint: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Where the sensor stood, in TARGET's frame.")
    ] = None,
    max_rotation: Annotated[
        float | None,
        typer.Option(
            metavar="DEG", help="The largest rotation between the files that is possible, to 180."
        ),
    ] = None,
) -> None:
    """Find the pose of SOURCE in the frame of TARGET, and the probability that it is right.

    Files: PLY, PCD, XYZ, TXT, CSV, TSV, ASC, PTS, NPY, NPZ; meshes PLY, OBJ, STL, OFF, GLB.

    Exit codes: 0 registered, 1 error, 2 wrong usage, 3 below --min-probability.
    """
    source_eye = parse_viewpoint(source_viewpoint, "--source-viewpoint")
    target_eye = parse_viewpoint(target_viewpoint, "--target-viewpoint")
    check_minimum(min_probability)
    if max_rotation is not None and not 0.0 < max_rotation <= 180.0:
        raise typer.BadParameter(
            f"--max-rotation: expected an angle above 0 and up to 180, got {max_rotation:g}"
        )

    from fullturn.io.save import CLOUD_SUFFIXES, save_cloud
    from fullturn.io.transform import TRANSFORM_SUFFIXES, write_transform

    check_outputs(
        (out, TRANSFORM_SUFFIXES),
        (save, CLOUD_SUFFIXES),
        (report, (".html", ".htm")),
        (figure, PICTURE_SUFFIXES),
        inputs=(source, target),
    )

    from fullturn.io import load_cloud

    source_cloud, target_cloud = load_cloud(source), load_cloud(target)

    from fullturn.api import register as run
    from fullturn.cli.render import print_json, print_table
    from fullturn.geometry.motion import move

    result = run(
        source_cloud,
        target_cloud,
        method=method,
        seed=seed,
        source_viewpoint=source_eye,
        target_viewpoint=target_eye,
        max_rotation_deg=max_rotation,
    )
    T = result.T_target_source
    if out is not None:
        write_transform(out, T)
    if save is not None:
        save_cloud(save, move(T, source_cloud.points))
    if report is not None:
        from fullturn.viz.report import write_report

        write_report(
            report,
            source_cloud.points,
            target_cloud.points,
            result,
            source_name=source_cloud.name,
            target_name=target_cloud.name,
        )
    if figure is not None:
        from fullturn.viz.figures import save_figure

        save_figure(figure, source_cloud.points, target_cloud.points, result)
    if json:
        print_json(result, source_name=str(source), target_name=str(target))
    else:
        print_table(result, source_name=str(source), target_name=str(target))
    exit_if_below(result.success_probability, min_probability)
