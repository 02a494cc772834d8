"""`fullturn demo`: scan an object twice, register the scans, compare with the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

OBJECT_NAME = "dog"
NOISE = 0.002  # standard deviation of the depth, in radii of the object
DISTANCE = 3.0  # of the eyes from the object, on average, in radii
LEAST_OVERLAP = 0.6  # share of each scan that the other one sees, too
_REPORT = "report.html"
_FILES = ("source.ply", "target.ply", "aligned.ply", "pose.txt", _REPORT, "demo.png")
_NAMES = {"source_name": f"{OBJECT_NAME}, scan 1", "target_name": f"{OBJECT_NAME}, scan 2"}


def demo(
    out: Annotated[Path, typer.Option(help="Folder for what is written; made if missing.")] = Path(
        "demo_output"
    ),
    seed: Annotated[int, typer.Option(min=0, help="Another seed, other views and poses.")] = 0,
    points: Annotated[int, typer.Option(min=200, help="Points per scan.")] = 4096,
    method: Annotated[str, typer.Option(help="See `fullturn methods`.")] = "auto",
) -> None:
    """Make two partial scans of an object in unknown poses, register them, check the answer.

    Writes source.ply, target.ply, aligned.ply, pose.txt, report.html and demo.png, over those of
    another demo, but over nothing else.
    """
    from fullturn.cli.outputs import check_folder
    from fullturn.methods.check import make_method

    make_method(method)  # says now, and not beside an empty folder, that there is none
    check_folder(out, _FILES, earlier=_FILES if _is_of_demo(out / _REPORT) else ())

    import numpy as np

    from fullturn.api import register
    from fullturn.cli.render import draw, print_table
    from fullturn.data.procedural import dog
    from fullturn.data.scan import scan_pair
    from fullturn.data.sensor import Sensor
    from fullturn.evaluation.metrics import mean_point_distance, rotation_error_deg
    from fullturn.geometry.motion import move
    from fullturn.io import save_cloud, write_transform
    from fullturn.viz.figures import save_figure
    from fullturn.viz.report import write_report

    typer.echo(f"Two scans of a {OBJECT_NAME}, {points:,} points each, from two sides, any pose …")
    pair = scan_pair(
        dog(),
        np.random.default_rng(seed),
        points=points,
        min_overlap=LEAST_OVERLAP,
        sensor=Sensor(noise=NOISE / DISTANCE**2),
        name=OBJECT_NAME,
    )
    result = register(pair.source, pair.target, method=method, seed=seed)
    T = result.T_target_source
    print_table(result, **_NAMES)

    angle_deg = float(rotation_error_deg(T, pair.T_target_source))
    distance = mean_point_distance(T, pair.T_target_source, pair.source)
    size = float(np.ptp(pair.target, axis=0).max())
    typer.echo(
        f"Error against the known truth: {angle_deg:.3f}° in rotation, and points are "
        f"{100 * distance / size:.3f} % of the object's size from where they belong."
    )

    # First, because it says whose folder this is.
    write_report(out / _REPORT, pair.source, pair.target, result, **_NAMES)
    save_cloud(out / "source.ply", pair.source)
    save_cloud(out / "target.ply", pair.target)
    save_cloud(out / "aligned.ply", move(T, pair.source))
    write_transform(out / "pose.txt", T)
    typer.echo(f"Open {out / _REPORT} in a browser to turn the result around.")
    draw(out / "demo.png", lambda path: save_figure(path, pair.source, pair.target, result))


def _is_of_demo(report: Path) -> bool:
    """Whether a demo wrote this report; none is none of it."""
    try:
        text = report.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return False
    return all(name in text for name in _NAMES.values())
