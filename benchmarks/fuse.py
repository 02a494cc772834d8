"""How well `fullturn fuse` puts many scans together: real ones, and views of known meshes.

    python benchmarks/fuse.py stanford --data DIR [--page docs/fuse.md]
    python benchmarks/fuse.py views --data DIR [--page docs/fuse.md]

`stanford`: DIR/stanford_scans holds ten scans of the bunny and fifteen of the dragon. Each comes
under a random rigid motion of its own, in random order: the bunny and the dragon five times each,
both mixed once. With --page, pictures of both are drawn.

`views`: DIR holds meshes_open.npz and meshes_research.npz. Of each of 40 `val` meshes, 8 out of 26
views by the virtual depth camera, 2,048 points each, under random rigid motions; without the places
of the camera, and with them.

One JSON line a case is appended to --out as it comes; a stopped run goes on where it was. Prints a
Markdown table; with --page, it goes between the marks of that page. How errors are counted:

- Scans are right or wrong relative to the rest of their group, which gets the frame in which most
  of them are right.
- Real scans: the angle to the reference pose, after the rotation of the whole group that brings it
  to the references best.
- Views: the error of a pose is a motion E of the true mesh, the identity where it is right. Where
  it turns by 5° or more, ICP of the whole surface with itself, from E on, gives S; if the surface
  moved by S lies on itself (on average within 0.5 % of the diameter, both ways), S is a symmetry,
  and E counts relative to it. What is only nearly a symmetry is none. The scan is right where less
  than 5° remain and its points are, on average, at most 1 % of the diameter farther from the
  surface than at their true places.
- "Within 5°": scans of the largest group that are right, of all. "Wrong merges": scans in a group
  of two or more, whichever, that are not, of all.
"""

from __future__ import annotations

import argparse
import io
import os
import resource
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch
from PIL import Image

from fullturn.data.mvp_views import in_unit_ball
from fullturn.data.shapes import MeshPack
from fullturn.evaluation.layout import Table, markdown, plain_header
from fullturn.fusion.fuse import fuse
from fullturn.fusion.report import scan_colors
from fullturn.fusion.result import Fusion
from fullturn.geometry.motion import move
from fullturn.io.atomic import write_atomic
from fullturn.viz.canvas import new_figure
from fullturn.viz.figures import draw_panel
from fullturn.viz.scene import thin
from fuse_cases import (
    MovedScans,
    Placed,
    Surface,
    placed_by_references,
    placed_by_surface,
    stanford,
    views_of,
)
from marked import rewrite
from rows import Row, add_data, collect_rows

OBJECTS = ("bunny", "dragon")
SETS = (("bunny",), ("dragon",), OBJECTS)
DRAWN = 4_000  # points of a scan
COLORS = 48  # of a picture's palette


def stanford_rows(args: argparse.Namespace, done: set[str]) -> Iterator[Row]:
    """One row a set of scans and seed."""
    for names in SETS:
        for seed in range(args.seeds if len(names) == 1 else 1):
            case = f"{' + '.join(names)}, seed {seed}"
            if case in done:
                continue
            rng = np.random.default_rng([seed, len(names), *map(ord, names[0])])
            scans = stanford(args.data / "stanford_scans", names, rng)
            row, fusion = fused(scans, case=case, known=False)
            placed = placed_by_references(fusion, scans)
            kinds = [{scans.objects[scan] for scan in group} for group in fusion.groups]
            yield {**row, "set": " + ".join(names), "pure": max(map(len, kinds)) == 1} | scored(
                placed
            )
            if args.page is not None and len(names) == 1 and seed == 0:
                picture = args.page.parent / "images" / f"fuse-{names[0]}.png"
                picture.parent.mkdir(parents=True, exist_ok=True)
                picture.write_bytes(drawing(fusion, scans))


def views_rows(args: argparse.Namespace, done: set[str]) -> Iterator[Row]:
    """One row a mesh and whether the places of the camera are known."""
    packs = [
        MeshPack(args.data / f"meshes_{kind}.npz", split=args.split)
        for kind in ("open", "research")
    ]
    for number in range(args.count):
        pack = packs[number % 2]
        cases = {f"mesh {number}, {word}": word == "known" for word in ("unknown", "known")}
        if done.issuperset(cases):
            continue
        # The next one where a mesh shows too little from most sides.
        index = number // 2 * 2 * len(pack) // args.count
        while True:
            mesh = in_unit_ball(pack.raw_mesh(index))
            scans = views_of(mesh, np.random.default_rng([args.seed, number]))
            if scans is not None:
                break
            index += 1
        surface = Surface(mesh)
        for case, known in cases.items():
            if case not in done:
                row, fusion = fused(scans, case=case, known=known)
                placed = placed_by_surface(fusion, scans, surface)
                yield {
                    **row,
                    "set": "known" if known else "unknown",
                    "name": pack.name(index),
                } | scored(placed)


def fused(scans: MovedScans, *, case: str, known: bool) -> tuple[Row, Fusion]:
    """The fusion, and what it took."""
    begin, cpu = time.perf_counter(), time.process_time()
    fusion = fuse(scans.clouds, viewpoints=scans.viewpoints if known else None)
    row = {
        "case": case,
        "scans": len(scans.clouds),
        "pairs": len(fusion.edges),
        "seconds": time.perf_counter() - begin,
        "cpu": time.process_time() - cpu,
        "peak_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }
    return row, fusion


def scored(placed: Sequence[Sequence[Placed]]) -> Row:
    """Group sizes and errors as numbers."""
    joined = [group for group in placed if len(group) > 1]
    return {
        "groups": [len(group) for group in placed],
        "errors_deg": [round(one.error_deg, 4) for group in joined for one in group],
        "right": sum(one.is_right for group in joined[:1] for one in group),
        "wrong": sum(not one.is_right for group in joined for one in group),
    }


def stanford_table(rows: Sequence[Row]) -> Table:
    """One line a set of scans, all its seeds together."""
    header = (
        "scans", "runs", "groups", "unlike scans in one group",
        "median error", "worst error", "wall-clock s", "CPU s", "pairs", "peak memory",
    )  # fmt: skip
    lines = []
    for name in dict.fromkeys(row["set"] for row in rows):
        of = [row for row in rows if row["set"] == name]
        errors = np.concatenate([row["errors_deg"] for row in of])
        groups = sorted({", ".join(map(str, row["groups"])) for row in of})
        lines.append(
            (
                name,
                str(len(of)),
                "; ".join(groups),
                "none" if all(row["pure"] for row in of) else "yes",
                f"{np.median(errors):.2f}°",
                f"{errors.max():.2f}°",
                *(
                    f"{np.mean([row[key] for row in of]):.0f}"
                    for key in ("seconds", "cpu", "pairs")
                ),
                f"{max(row['peak_gb'] for row in of):.1f} GB",
            )
        )
    return Table("fuse-stanford", "Real scans", plain_header(header), tuple(lines))


def views_table(rows: Sequence[Row]) -> Table:
    """One line without the places of the camera, and one with them."""
    header = (
        "places of the camera", "meshes", "within 5°", "wrong merges",
        "all in one group", "median error", "CPU s a mesh",
    )  # fmt: skip
    lines = []
    for name in dict.fromkeys(row["set"] for row in rows):
        of = [row for row in rows if row["set"] == name]
        total = sum(row["scans"] for row in of)
        whole = np.mean([len(row["groups"]) == 1 for row in of])
        errors = np.concatenate([row["errors_deg"] for row in of])
        lines.append(
            (
                name,
                str(len(of)),
                *(
                    f"{100 * sum(row[key] for row in of) / total:.1f} %"
                    for key in ("right", "wrong")
                ),
                f"{100 * whole:.0f} %",
                f"{np.median(errors):.2f}°",
                f"{np.mean([row['cpu'] for row in of]):.1f}",
            )
        )
    return Table("fuse-views", "Views", plain_header(header), tuple(lines))


def drawing(fusion: Fusion, scans: MovedScans) -> bytes:
    """The scans as they came, and the largest group upright, from both sides; a PNG file."""
    group = fusion.groups[0]
    upright = scans.T_object_scan[group[0]]
    turn = np.diag([-1.0, 1.0, -1.0])
    front = [
        move(upright @ T, thin(scans.clouds[s], DRAWN))
        for s in group
        if (T := fusion.T_world_scan[s]) is not None
    ]
    came = [thin(cloud - cloud.mean(0), DRAWN) for cloud in scans.clouds]
    size = 1.1 * max(float(np.ptp(cloud, axis=0).max()) for cloud in came)
    columns = int(np.ceil(np.sqrt(len(came))))
    spread = [
        cloud + size * np.array([k % columns, -(k // columns), 0.0]) for k, cloud in enumerate(came)
    ]
    tones = np.array(scan_colors(len(came))) / 255.0
    panels = {
        f"{len(came)} scans as they came": (spread, tones),
        "fused": (front, tones[list(group)]),
        "from behind": ([cloud @ turn for cloud in front], tones[list(group)]),
    }
    figure = new_figure(figsize=(12.0, 4.2), layout="constrained")
    for axes, (name, (clouds, colors)) in zip(figure.subplots(1, 3), panels.items(), strict=True):
        points = np.concatenate(clouds)
        by_point = np.repeat(colors, [len(cloud) for cloud in clouds], axis=0)
        draw_panel(axes, name, points, by_point, height=float(np.ptp(points[:, 1])))
    drawn, packed = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, format="png", dpi=80)
    picture = Image.open(drawn).convert("RGB").quantize(COLORS, dither=Image.Dither.NONE)
    picture.save(packed, format="png", optimize=True)
    return packed.getvalue()


def main() -> None:
    """Fuse, count, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("what", choices=("stanford", "views"))
    add_data(parser, "stanford_scans and the mesh packs")
    parser.add_argument("--seeds", type=int, default=5, help="of stanford")
    parser.add_argument("--count", type=int, default=40, help="meshes of views")
    parser.add_argument("--split", default="val", help="of the meshes")
    parser.add_argument("--seed", type=int, default=0, help="of views")
    parser.add_argument("--out", type=Path, help="default: results/fuse-WHAT.jsonl")
    parser.add_argument("--page", type=Path, help="page whose table it is")
    args = parser.parse_args()
    if args.data is None:
        parser.error("--data: expected the folder of the scans and mesh packs")
    torch.set_num_threads(1)
    out = args.out or Path("results") / f"fuse-{args.what}.jsonl"
    make, tabulate = {
        "stanford": (stanford_rows, stanford_table),
        "views": (views_rows, views_table),
    }[args.what]

    def missing(rows: list[Row]) -> Iterator[Row]:
        return make(args, {row["case"] for row in rows})

    def tell(row: Row) -> None:
        print(row["case"], row["groups"], f"{row['cpu']:.0f} s", file=sys.stderr)

    rows = collect_rows(out, missing, tell=tell)
    found = markdown(tabulate(rows))
    print(found)
    if args.what == "stanford":
        names = ((name, f"images/fuse-{name}.png") for name in OBJECTS)
        found += "".join(f"\n![The scans of the {name}, fused]({path})\n" for name, path in names)
    if args.page is not None:
        page = args.page.read_text(encoding="utf-8")
        begin, end = (f"<!-- {args.what}:{word} -->" for word in ("start", "end"))
        write_atomic(args.page, rewrite(page, f"\n{found}\n", begin, end))


if __name__ == "__main__":
    main()
