"""The tables of the README: from files alone, and only of methods that saw the same pairs."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import common
import tables


def row(name: str, error_deg: float) -> dict:
    return {
        "name": name, "rotation_error_deg": error_deg, "translation_error": 0.0,
        "mean_point_distance": 0.0, "rmse": 0.0, "rmse_paper": 0.0, "success": error_deg < 5.0,
        "geometric_success": True, "any_success": True, "success_probability": 0.75,
        "alternatives": 0, "error": None, "seconds": {}, "cpu_seconds": 0.5, "wall_seconds": 0.5,
    }  # fmt: skip


def write(folder: Path, stem: str, names: tuple[str, ...]) -> None:
    pairs = [row(name, float(20 * i)) for i, name in enumerate(names)]
    part = {"summary": common.summarize(pairs, seed=0), "pairs": pairs}
    report = {"method": "consensus", "seed": 0, "sets": {"modelnet40/clean/180": part}}
    (folder / f"{stem}.json").write_text(json.dumps(report))


def test_without_results_there_is_no_section(tmp_path: Path) -> None:
    assert tables.section(tmp_path) == ""
    write(tmp_path, "open3d_modelnet", ("a", "b"))
    assert tables.section(tmp_path) == ""  # the other method alone says nothing


def test_methods_stand_beside_one_another(tmp_path: Path) -> None:
    for stem in ("modelnet", "open3d_modelnet"):
        write(tmp_path, stem, ("a", "b"))
    text = tables.section(tmp_path)
    numbers = "10.00 | 10.00 | 50.0 % | 50.0 % | 75.0 % | 0.50 |"
    assert f"| clean (2) | fullturn | {numbers}" in text
    assert f"|  | Open3D | {numbers}" in text
    assert "0.036" in text
    assert "--count 2 --method consensus --seed 0" in text


def test_other_pairs_are_refused(tmp_path: Path) -> None:
    write(tmp_path, "modelnet", ("a", "b"))
    write(tmp_path, "open3d_modelnet", ("a", "c"))
    with pytest.raises(SystemExit, match="the same pairs"):
        tables.section(tmp_path)


def test_rewriting_twice_changes_nothing_and_keeps_the_rest() -> None:
    readme = f"before\n{tables.BEGIN}\nold\n{tables.END}\nafter\n"
    once = tables.rewrite(readme, "new\n")
    assert once == f"before\n{tables.BEGIN}\nnew\n{tables.END}\nafter\n"
    assert tables.rewrite(once, "new\n") == once
    with pytest.raises(SystemExit, match="put them back"):
        tables.rewrite("no marks", "new\n")
