"""How often `fullturn locate` finds a known mesh in a virtual scan, how well, how fast.

    python benchmarks/locate.py --data DIR [--count 100] [--out FILE.jsonl] [--page docs/locate.md]

DIR holds meshes_open.npz and meshes_research.npz; their `val` meshes take turns, each in a unit and
a frame of its own. Each is scanned twice with sensor noise, once alone and once on a support plane,
and a third time on a plane with one or two other objects beside it. Every scan is located with the
place of the sensor and without. One JSON line a scan and case is appended as it comes; a stopped
run goes on where it was. Prints a Markdown table, and with --page puts it into the page.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch
import trimesh

from fullturn.data.shapes import MeshPack
from fullturn.data.surface import sample_surface
from fullturn.evaluation.layout import Table, markdown, plain_header
from fullturn.evaluation.metrics import (
    add,
    add_s,
    expected_calibration_error,
    pose_success,
    rotation_error_deg,
)
from fullturn.geometry.diameter import diameter
from fullturn.io.atomic import write_atomic
from fullturn.locating.locate import locate
from fullturn.locating.model import prepare
from locate_scenes import Scene, model_in_own_unit, scene_of
from marked import rewrite
from rows import Row, add_data, collect_rows

BEGIN, END = "<!-- locate: begin -->", "<!-- locate: end -->"
SCENES = ("alone", "plane", "others")
_SAMPLES = 2000  # points of a mesh that the errors are taken on
_TRIES = 20  # for a scan that shows enough of the mesh


def meshes(data: Path, split: str) -> list[tuple[str, trimesh.Trimesh]]:
    """The meshes of both packs, taking turns, evenly over each."""
    packs = [MeshPack(data / f"meshes_{kind}.npz", split=split) for kind in ("open", "research")]
    count = min(map(len, packs))
    return [
        (pack.name(i), pack.mesh(i))
        for number in range(count)
        for pack in packs
        for i in [number * len(pack) // count]
    ]


def scene_with(
    kind: str, mesh: trimesh.Trimesh, others: list[trimesh.Trimesh], rng: np.random.Generator
) -> Scene:
    """A scan that shows enough of the mesh."""
    for _ in range(_TRIES):
        beside = others if kind == "others" else []
        scene = scene_of(mesh, rng, plane=kind != "alone", others=beside)
        if scene is not None:
            return scene
    raise SystemExit(f"expected a scan with enough of the mesh in {_TRIES} tries, got none")


def cases(args: argparse.Namespace, done: set[tuple[int, str, bool]]) -> Iterator[dict[str, Any]]:
    """One row a mesh, kind of scene and known or unknown place of the sensor."""
    shapes = meshes(args.data, args.split)
    picked = [int(k * len(shapes) / args.count) for k in range(args.count)]
    for number, index in enumerate(picked):
        wanted = [(number, kind, known) for kind in args.scenes for known in (True, False)]
        if done.issuperset(wanted):
            continue
        rng = np.random.default_rng([args.seed, number])
        name, mesh = shapes[index]
        mesh = model_in_own_unit(mesh, rng)
        begin = time.process_time()
        model = prepare(mesh)
        preparing = time.process_time() - begin
        points = sample_surface(mesh, _SAMPLES, np.random.default_rng(0))
        across = diameter(mesh.vertices)
        others = [shapes[int(i)][1] for i in rng.integers(len(shapes), size=rng.integers(1, 3))]
        for kind in args.scenes:
            drawn = np.random.default_rng([args.seed, number, SCENES.index(kind)])
            scene = scene_with(kind, mesh, others, drawn)
            for known in (True, False):
                if (number, kind, known) in done:
                    continue
                begin = time.process_time()
                found = locate(
                    model, scene.points, scene_viewpoint=scene.viewpoint if known else None
                )
                seconds = time.process_time() - begin
                T, T_true = found.T_scene_model, scene.T_scene_model
                yield {
                    "number": number,
                    "kind": kind,
                    "known": known,
                    "mesh": name,
                    "points": len(scene.points),
                    "add": add(T, T_true, points) / across,
                    "add_s": add_s(T, T_true, points) / across,
                    "angle_deg": float(rotation_error_deg(T, T_true)),
                    "pose": pose_success(T, T_true, points),
                    "success_probability": found.success_probability,
                    "surface_probability": found.surface_probability,
                    "seconds": seconds,
                    "preparing": preparing,
                }


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown: one line a kind of scene, with and without the place of the sensor."""
    cells = []
    for kind in SCENES:
        for known in (True, False):
            of = [row for row in rows if (row["kind"], row["known"]) == (kind, known)]
            if not of:
                continue
            got = {key: np.array([row[key] for row in of]) for key in of[0]}
            ece = expected_calibration_error(got["success_probability"], got["pose"])
            surface = expected_calibration_error(got["surface_probability"], got["add_s"] < 0.05)
            cells.append(
                (
                    kind,
                    "known" if known else "unknown",
                    str(len(of)),
                    *(f"{100 * np.mean(got[key] < 0.1):.1f} %" for key in ("add_s", "add")),
                    f"{100 * np.mean(got['angle_deg'] < 5):.1f} %",
                    f"{100 * np.median(got['add_s']):.2f} %",
                    f"{ece:.3f}",
                    f"{surface:.3f}",
                    f"{got['seconds'].mean():.2f}",
                    f"{np.quantile(got['seconds'], 0.95):.2f}",
                    f"{got['preparing'].mean():.1f}",
                )
            )
    header = (
        "scene",
        "sensor",
        "scans",
        "ADD-S < 10 %",
        "ADD < 10 %",
        "within 5°",
        "median ADD-S",
        "ECE of the pose",
        "ECE of the surface",
        "CPU s",
        "95 % below",
        "preparing s",
    )
    return markdown(Table("locate", "Locate", plain_header(header), tuple(cells)))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add_data(parser, "the mesh packs")
    parser.add_argument("--count", type=int, default=100, help="meshes")
    parser.add_argument("--split", default="val")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("results/locate.jsonl"))
    parser.add_argument("--page", type=Path, help="page whose table it is")
    args = parser.parse_args()
    if args.data is None:
        parser.error("--data: expected the folder of the mesh packs")
    torch.set_num_threads(1)

    def missing(rows: list[Row]) -> Iterator[Row]:
        return cases(args, {(row["number"], row["kind"], row["known"]) for row in rows})

    rows = collect_rows(args.out, missing)
    found = table(rows)
    print(found)
    if args.page is not None:
        page = args.page.read_text(encoding="utf-8")
        write_atomic(args.page, rewrite(page, f"\n{found}\n", BEGIN, END))


if __name__ == "__main__":
    main()
