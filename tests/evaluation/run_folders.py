"""Run folders written by hand, with numbers that no method has reached."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

# fmt: off
COLUMNS = (
    "method", "index", "name", "group", "related", "rotation_error_deg", "translation_error",
    "mean_point_distance", "rmse", "rmse_paper", "success", "geometric_success", "any_success",
    "success_probability", "alternatives", "error",
)
# fmt: on


def summary(*, mean_deg: float = 2.5, states: bool = True, **other: Any) -> dict[str, Any]:
    """What a method reached on four pairs."""
    part = {
        "n": 4, "unrelated": 0, "mean_deg": mean_deg, "mean_deg_interval": [1.25, 4.5],
        "median_deg": 0.5, "recall_0.1deg": 0.0, "recall_1deg": 0.5, "recall_5deg": 0.75,
        "recall_5deg_interval": [0.25, 1.0], "recall_10deg": 1.0, "recall_0.1_distance": 1.0,
        "mean_translation_error": 0.0123, "median_translation_error": 0.01,
        "mean_mean_point_distance": 0.0456, "median_mean_point_distance": 0.04,
        "mean_rmse": 0.05, "median_rmse": 0.05, "mean_rmse_paper": 0.002,
        "median_rmse_paper": 0.002, "success": 0.75, "any_success": 1.0, "geometric_success": 1.0,
        "geometric_success_interval": [1.0, 1.0], "errors": 1,
    }  # fmt: skip
    if states:
        part |= {"mean_probability": 0.625, "calibration_error": 0.0875, "brier": 0.1}
        part |= {"risk_coverage": {"1.0": 0.25}}
    return part | other


def set_part(methods: dict[str, dict[str, Any]], **other: Any) -> dict[str, Any]:
    """A set of four pairs."""
    shapes = {"kind": "part of ModelNet40", "file": "shapes.npz", "part": "test", "count": 9}
    description = {"kind": "protocol", "seed": 3, "count": 4, "shapes": shapes}
    return {"description": description, "count": 4, "methods": methods, **other}


def write_run(
    folder: Path, sets: dict[str, dict[str, Any]], *, seed: int = 5, timing: bool = True
) -> Path:
    """A run folder with rows of pairs: the last pair of each method failed."""
    (folder / "pairs").mkdir(parents=True)
    methods = {
        m: {"summary": "", "reference": ""} for part in sets.values() for m in part["methods"]
    }
    content = {"format": 1, "fullturn": "0", "commit": None, "seed": seed, "methods": methods}
    (folder / "summary.json").write_text(json.dumps({**content, "sets": sets}))
    for name, part in sets.items():
        with open(folder / "pairs" / f"{name.replace('/', '-')}.csv", "w", newline="") as stream:
            writer = csv.DictWriter(stream, COLUMNS, restval="", lineterminator="\n")
            writer.writeheader()
            for number, (method, reached) in enumerate(part["methods"].items()):
                for index in range(reached["n"]):
                    row = {"method": method, "index": index, "related": 1}
                    row["rotation_error_deg"] = f"{0.2 * (number + 1) * 4**index:.6g}"
                    row["success"] = int(index < 2)
                    if "mean_probability" in reached:
                        row["success_probability"] = f"{0.95 - 0.2 * index:.6g}"
                    if index == reached["n"] - 1:
                        row |= {"error": "InputError: no", "success_probability": "", "success": 0}
                    writer.writerow(row)
    if timing:
        times = {
            name: {m: {"cpu_seconds_median": 0.375} for m in part["methods"]}
            for name, part in sets.items()
        }
        machine = {"python": "3", "processor": "abacus", "threads": 1}
        (folder / "timing.json").write_text(json.dumps({"machine": machine, "sets": times}))
    return folder
