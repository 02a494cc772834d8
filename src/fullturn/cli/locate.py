"""`fullturn locate MODEL SCENE`: where a known model stands in a scan."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fullturn.cli.minimum import check_minimum, exit_if_below
from fullturn.cli.viewpoint import parse_viewpoint

if TYPE_CHECKING:
    from fullturn.locating.model import PreparedModel
    from fullturn.locating.result import Located


def locate(
    model: Annotated[
        Path,
        typer.Argument(
            metavar="MODEL", help="Mesh, complete cloud, or prepared model (.safetensors)."
        ),
    ],
    scene: Annotated[
        Path, typer.Argument(metavar="SCENE", help="Scan in which the model stands somewhere.")
    ],
    prepared: Annotated[
        Path | None,
        typer.Option(help="Prepared model, .safetensors: read if it is there, else written."),
    ] = None,
    viewpoint: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Where the sensor stood, in SCENE's frame.")
    ] = None,
    instances: Annotated[
        int, typer.Option(min=0, help="How many to look for at most; 0: as many as there are.")
    ] = 1,
    min_probability: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=1.0,
            help="Exit with 3 if the first is below this; further ones must reach it (0.5).",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Write the first 4×4 transform: .txt or .json.")
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option(help="Write the model's surface in the scene: .ply, .npy, .xyz, .txt, .csv."),
    ] = None,
    json: Annotated[
        bool, typer.Option("--json", help="Print the result as one JSON object.")
    ] = False,
) -> None:
    """Find MODEL in SCENE, and the probability that it is there. Both are in one unit.

    Files: PLY, PCD, XYZ, TXT, CSV, TSV, ASC, PTS, NPY, NPZ; meshes PLY, OBJ, STL, OFF, GLB.

    Exit codes: 0 located, 1 error, 2 wrong usage, 3 below --min-probability.
    """
    eye = parse_viewpoint(viewpoint, "--viewpoint")
    check_minimum(min_probability)
    if prepared is not None and model.suffix.lower() == ".safetensors":
        raise typer.BadParameter("MODEL is a prepared one itself", param_hint="'--prepared'")

    from fullturn.cli.outputs import check_outputs
    from fullturn.io.atomic import check_path
    from fullturn.io.save import CLOUD_SUFFIXES, save_cloud
    from fullturn.io.transform import TRANSFORM_SUFFIXES, write_transform

    # One that exists is read, and may lie where nothing can be written.
    is_made = prepared is not None and not check_path(prepared, (".safetensors",)).exists()
    check_outputs(
        (out, TRANSFORM_SUFFIXES),
        (save, CLOUD_SUFFIXES),
        (prepared if is_made else None, (".safetensors",)),
        inputs=(model, scene, None if is_made else prepared),
    )

    from fullturn.io import load_cloud

    cloud = load_cloud(scene)

    import numpy as np

    from fullturn.geometry.motion import move
    from fullturn.locating.locate import locate as run

    begin = time.perf_counter()
    ready = _ready(model, prepared)
    preparing = time.perf_counter() - begin
    result = run(
        ready,
        cloud,
        scene_viewpoint=eye,
        instances=instances or None,
        min_probability=0.5 if min_probability is None else min_probability,
    )
    seconds = {**result.seconds, "prepare": preparing}
    seconds["total"] += preparing
    result = replace(result, seconds=seconds)
    if out is not None:
        write_transform(out, result.T_scene_model, name="T_scene_model")
    if save is not None:
        surface = ready.points()
        poses = [place.T_scene_model for place in result.locations]
        save_cloud(save, np.concatenate([move(T, surface) for T in poses]))
    if json:
        from json import dumps

        print(dumps(_content(result, str(model), str(scene))))
    else:
        _print_table(result, str(model), str(scene))
    exit_if_below(result.surface_probability, min_probability)


def _ready(model: Path, prepared: Path | None) -> PreparedModel:
    from fullturn.locating.model import prepare
    from fullturn.locating.store import SUFFIX, load_prepared

    if model.suffix.lower() == SUFFIX:
        return load_prepared(model)
    if prepared is not None and prepared.exists():
        return load_prepared(prepared, model=model)
    ready = prepare(model)
    if prepared is not None:
        ready.save(prepared)
    return ready


def _content(result: Located, model: str, scene: str) -> dict[str, Any]:
    first = result.locations[0]
    return {
        "T_scene_model": first.T_scene_model.tolist(),
        "success_probability": first.success_probability,
        "surface_probability": first.surface_probability,
        "locations": [
            {
                "T_scene_model": place.T_scene_model.tolist(),
                "success_probability": place.success_probability,
                "surface_probability": place.surface_probability,
                "visible_share": place.visible_share,
                "points": place.points,
                "alternatives": [
                    {
                        "T_scene_model": other.T_scene_model.tolist(),
                        "success_probability": other.success_probability,
                        "surface_probability": other.surface_probability,
                    }
                    for other in place.alternatives
                ],
            }
            for place in result.locations
        ],
        "seconds": result.seconds,
        "notes": list(result.notes),
        "model": model,
        "scene": scene,
    }


def _print_table(result: Located, model: str, scene: str) -> None:
    from rich.console import Console

    from fullturn.cli.render import titled_rows
    from fullturn.geometry.motion import invert, rotation_angle_deg
    from fullturn.viz.tables import probability

    table, row = titled_rows()
    row("model in scene", f"{model} in {scene}")
    for number, place in enumerate(result.locations, start=1):
        T = place.T_scene_model
        if len(result.locations) > 1:
            row(f"instance {number}", "")
        row("rotation", f"{rotation_angle_deg(T[:3, :3]):.2f}°")
        row("translation", "  ".join(f"{x:.6g}" for x in T[:3, 3]))
        row("probability", f"{probability(place.surface_probability)} that its surface lies there")
        row("of the pose", f"{probability(place.success_probability)} that it is the true one")
        row("seen", f"{place.visible_share:.0%} of the model's outside")
        for rank, other in enumerate(place.alternatives, start=1):
            angle_deg = rotation_angle_deg((invert(T) @ other.T_scene_model)[:3, :3])
            stated = probability(other.success_probability)
            row(f"alternative {rank}", f"probability {stated}, {angle_deg:.1f}° away")
    for note in result.notes:
        row("note", note)
    row("seconds", f"{result.seconds['total']:.2f}")
    Console().print(table)
