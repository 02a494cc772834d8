"""Benchmark a method on real range scans: the Stanford bunny and dragon.

    python benchmarks/real_scans.py --data DIR --method consensus

Every pair with an overlap of 0.3 and more, and those of 0.1 to 0.3 apart; each cloud under its own
random rigid motion. The true poses are Stanford's own alignment, a reference and not exact.
"""

from __future__ import annotations

import argparse
import csv
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common import (
    SUMMARY_HEADER,
    Registrar,
    argument_parser,
    data_folder,
    fullturn_registrar,
    markdown_table,
    percent,
    run_pairs,
    summarize,
    summary_cells,
    values,
    write_results,
)
from fullturn.data.motion import ball_translation, invert, move, rigid, uniform_rotation
from fullturn.data.pair import Pair

OVERLAP_CLASSES = {"0.6 and more": 0.6, "0.3 to 0.6": 0.3, "0.1 to 0.3": 0.1}


@dataclass(frozen=True)
class ScanPair:
    """A pair and what is known about it."""

    pair: Pair
    object: str
    overlap: float  # the smaller of the two shares
    angle_deg: float  # between the two scans as they were taken
    extent: float  # diagonal of the bounding box of the joined scans


def read_scan(path: Path) -> np.ndarray:
    """The points of a binary little-endian PLY file that holds float x, y, z alone."""
    content = path.read_bytes()
    start = content.index(b"end_header\n") + len(b"end_header\n")
    return np.frombuffer(content, "<f4", offset=start).reshape(-1, 3).astype(np.float64)


def load_pairs(folder: Path, *, seed: int, least_overlap: float = 0.1) -> list[ScanPair]:
    """All pairs of all objects; the motion of pair k of the list depends only on (seed, k)."""
    loaded = []
    for poses_file in sorted(folder.glob("*/poses.json")):
        poses = {name: np.array(T) for name, T in json.loads(poses_file.read_text()).items()}
        scans = {name: read_scan(poses_file.parent / name) for name in poses}
        world = np.concatenate([move(poses[name], scans[name]) for name in poses])
        extent = float(np.linalg.norm(np.ptp(world, axis=0)))
        with open(poses_file.parent / "pairs.csv", newline="") as stream:
            listed = list(csv.DictReader(stream))
        for row in listed:
            overlap = float(row["overlap_min"])
            if overlap < least_overlap:
                continue
            rng = np.random.default_rng([seed, len(loaded)])
            source, target = row["source"], row["target"]
            T_source_scan, T_target_scan = (
                rigid(uniform_rotation(rng), ball_translation(rng, max_length=extent))
                for _ in range(2)
            )
            T_scan = invert(poses[target]) @ poses[source]
            pair = Pair(
                move(T_source_scan, scans[source]),
                move(T_target_scan, scans[target]),
                T_target_scan @ T_scan @ invert(T_source_scan),
                f"{poses_file.parent.name}/{source}-{target}",
            )
            loaded.append(
                ScanPair(
                    pair, poses_file.parent.name, overlap, float(row["relative_angle_deg"]), extent
                )
            )
    return loaded


def overlap_class(overlap: float) -> str:
    """The name of the class that an overlap falls in."""
    return next(name for name, least in OVERLAP_CLASSES.items() if overlap >= least)


def run(registrar: Registrar, label: str, arguments: argparse.Namespace, data: Path) -> None:
    """Run all pairs and write the results by object and overlap."""
    scans = load_pairs(data / "stanford_scans", seed=arguments.seed)[: arguments.count]
    rows = run_pairs(
        registrar,
        [scan.pair for scan in scans],
        seed=arguments.seed,
        workers=arguments.workers,
    )
    for row, scan in zip(rows, scans, strict=True):
        row["object"], row["overlap"], row["angle_deg"] = scan.object, scan.overlap, scan.angle_deg
        row["overlap_class"] = overlap_class(scan.overlap)
        row["translation_share"] = row["translation_error"] / scan.extent
    groups = {"overlap 0.3 and more": [row for row in rows if row["overlap"] >= 0.3]}
    for kind in sorted({row["object"] for row in rows}):
        groups[f"{kind}, 0.3 and more"] = [
            row for row in rows if row["object"] == kind and row["overlap"] >= 0.3
        ]
    for kind in OVERLAP_CLASSES:
        groups[f"overlap {kind}"] = [row for row in rows if row["overlap_class"] == kind]
    for kind in sorted({row["object"] for row in rows}):
        groups[f"{kind}, 0.1 to 0.3"] = [
            row for row in rows if row["object"] == kind and row["overlap"] < 0.3
        ]
    summaries = {}
    for name, group in groups.items():
        if group:
            summaries[name] = summarize(group, seed=arguments.seed)
            share = values(group, "translation_share")
            summaries[name]["median_translation_share"] = float(np.median(share))
            summaries[name]["mean_translation_share"] = float(share.mean())
    table = markdown_table(
        (*SUMMARY_HEADER, "median translation error, % of extent"),
        [
            [*summary_cells(name, summary), percent(summary["median_translation_share"])]
            for name, summary in summaries.items()
        ],
    )
    write_results(
        arguments.out,
        arguments.name,
        {"method": label, "seed": arguments.seed, "summaries": summaries, "pairs": rows},
        f"# Stanford scans: {label}, seed {arguments.seed}\n\n{table}",
    )


def main() -> None:
    """Benchmark a registered method."""
    parser = argument_parser(__doc__.splitlines()[0], count=1000, name="real_scans")
    arguments = parser.parse_args()
    run(
        fullturn_registrar(arguments.method),
        arguments.method,
        arguments,
        data_folder(parser, arguments),
    )


if __name__ == "__main__":
    main()
