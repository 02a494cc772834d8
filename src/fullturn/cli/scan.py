"""`fullturn scan MESH`: range scans of a mesh from all around, with their true poses."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fullturn.cli.errors import tell
from fullturn.cli.sensor import Flying, Grazing, Holes, Noise, Quantize

if TYPE_CHECKING:
    from fullturn.data.views import RangeView

_POSES, _SHEET = "poses.json", "contact_sheet.png"
_BEGUN = "scanning.json"  # lists the clouds of a run that hasn't ended


def scan(
    mesh: Annotated[
        Path, typer.Argument(metavar="MESH", help="Triangles: PLY, OBJ, STL, OFF, GLB.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for what is written; made if missing.")],
    views: Annotated[int, typer.Option(min=1, help="Evenly spread directions.")] = 26,
    points: Annotated[
        int, typer.Option(min=0, help="At most so many per view; 0: every pixel's.")
    ] = 2048,
    distance: Annotated[
        float, typer.Option(help="From the middle of the object to the eye, in radii; above 1.")
    ] = 3.0,
    noise: Noise = 0.0,
    quantize: Quantize = 0.0,
    grazing: Grazing = 0.0,
    flying: Flying = 0.0,
    holes: Holes = 0,
    plane: Annotated[
        bool, typer.Option("--plane", help="Stand the object on a plane; all eyes are above it.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same scans.")] = 0,
    width: Annotated[int, typer.Option(min=1, help="Pixels a side of the depth images.")] = 320,
) -> None:
    """Scan a MESH with a virtual depth camera from all around.

    Writes view_00.ply and so on, each in its camera's frame, poses.json with the true poses, and
    contact_sheet.png where matplotlib is installed. Clouds that the folder's poses.json lists are
    replaced or removed; files of these names that no earlier scan wrote are an error.
    """
    from dataclasses import asdict

    import numpy as np

    from fullturn.cli.outputs import check_folder
    from fullturn.cli.render import draw
    from fullturn.data.sensor import Sensor
    from fullturn.data.views import view_mesh
    from fullturn.io.atomic import write_atomic
    from fullturn.io.load import load_mesh
    from fullturn.io.save import save_cloud
    from fullturn.progress import progress_bar
    from fullturn.viz.contact_sheet import save_contact_sheet

    sensor = Sensor(noise=noise, quantize=quantize, grazing_deg=grazing, flying=flying, holes=holes)
    scans = view_mesh(
        load_mesh(mesh),
        views=views,
        distance=distance,
        points=points or None,
        sensor=sensor,
        plane=plane,
        width=width,
        height=width,
        rng=np.random.default_rng(seed),
    )
    digits = max(2, len(str(views - 1)))
    names = [f"view_{number:0{digits}d}" for number in range(views)]
    earlier = _names(out / _POSES) | _names(out / _BEGUN)
    files = [*(f"{name}.ply" for name in names), _POSES, _BEGUN, _SHEET]
    own = {_POSES, _BEGUN, _SHEET, *(f"{name}.ply" for name in earlier)} if earlier else set()
    check_folder(out, files, earlier=own, inputs=(mesh,))
    about = {
        "mesh": mesh.name,
        "seed": seed,
        "distance": distance,
        "sensor": asdict(sensor),
        "plane": plane,
    }
    # An interrupted run leaves clouds without poses, rather than with those of the run before.
    begun = [{"name": name} for name in sorted(earlier.union(names))]
    write_atomic(out / _BEGUN, _json(about, begun))
    (out / _POSES).unlink(missing_ok=True)
    entries, depths = [], []
    with progress_bar("scanning", views) as advance:
        for name, view in zip(names, scans, strict=True):
            entries.append({"name": name, **_entry(view)})
            if len(view.points_camera):
                save_cloud(out / f"{name}.ply", view.points_camera)
            depths.append(view.image.depth)
            advance(1)
    write_atomic(out / _POSES, _json(about, entries))
    _remove(out, earlier - {entry["name"] for entry in entries if entry["points"]})
    (out / _BEGUN).unlink()

    counts = [entry["points"] for entry in entries]
    blind = [entry["name"] for entry in entries if not entry["points"]]
    if blind:
        tell(f"{len(blind)} of {views} views see nothing, no cloud is written: {', '.join(blind)}")
    typer.echo(
        f"{views - len(blind)} of {views} views have points, {min(counts):,} to {max(counts):,} "
        f"each; clouds and {_POSES}: {out}"
    )
    focals = [entry["focal"] for entry in entries]
    labels = [f"{entry['name']}: {entry['points']:,}" for entry in entries]
    draw(
        out / _SHEET,
        lambda path: save_contact_sheet(path, depths, focals=focals, labels=labels),
    )


def _entry(view: RangeView) -> dict[str, Any]:
    """What poses.json says of a view; lengths in the unit of the mesh, `focal` in pixels."""
    from fullturn.geometry.motion import invert

    camera = view.camera
    return {
        "points": len(view.points_camera),
        "plane_points": int(view.on_plane.sum()),
        "T_object_camera": invert(camera.T_camera_object).tolist(),
        "viewpoint": camera.center.tolist(),
        "focal": camera.focal,
        "width": camera.width,
        "height": camera.height,
    }


def _json(about: dict[str, Any], entries: list[dict[str, Any]]) -> str:
    """One line a view, so that a person can read it."""
    import json

    head = json.dumps(about, indent=1).removesuffix("\n}")
    views = ",\n  ".join(json.dumps(entry) for entry in entries)
    return f'{head},\n "views": [\n  {views}\n ]\n}}\n'


def _names(poses: Path) -> set[str]:
    """The views that an earlier run's poses.json lists; none where it is another file or none."""
    import json
    import re

    try:
        views = json.loads(poses.read_text(encoding="utf-8"))["views"]
        names = {view["name"] for view in views}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return set()
    return {
        name for name in names if isinstance(name, str) and re.fullmatch("view_[0-9]{2,}", name)
    }


def _remove(folder: Path, names: set[str]) -> None:
    """Remove an earlier run's clouds, so that nobody takes them for this one's, and say so."""
    from fullturn.errors import WriteError, one_line

    places = [folder / f"{name}.ply" for name in sorted(names)]
    places = [place for place in places if place.is_file()]
    for place in places:
        try:
            place.unlink()
        except OSError as error:
            raise WriteError(
                f"cannot remove {one_line(place)} of an earlier run: {error.strerror}; "
                "remove it yourself"
            ) from error
    if places:
        removed = ", ".join(place.name for place in places)
        tell(f"removed the clouds that only an earlier run wrote: {removed}")
