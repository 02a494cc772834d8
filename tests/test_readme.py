"""What the README shows works: its Python runs, its files exist, its commands are real."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", README, flags=re.DOTALL | re.MULTILINE)


@pytest.fixture
def folder_with_scans(tmp_path):
    """An empty folder with the two scans that the README speaks of, as PLY and XYZ."""
    from fullturn.data.procedural import dog
    from fullturn.data.scan import scan_pair
    from fullturn.io import save_cloud

    pair = scan_pair(dog(), np.random.default_rng(0), points=512, min_overlap=0.4)
    for name, points in (("scan_a", pair.source), ("scan_b", pair.target)):
        save_cloud(tmp_path / f"{name}.ply", points)
        save_cloud(tmp_path / f"{name}.xyz", points)
    return tmp_path


def test_there_are_blocks():
    assert len(BLOCKS) >= 3


@pytest.mark.parametrize("block", [pytest.param(b, id=str(i)) for i, b in enumerate(BLOCKS)])
def test_python_block_runs(block, folder_with_scans, monkeypatch):
    monkeypatch.chdir(folder_with_scans)
    exec(compile(block, "README.md", "exec"), {"__name__": "__main__"})


def test_linked_files_exist():
    links = re.findall(r"\]\(([^)#:]+)\)", README)
    assert "LICENSE" in links
    missing = [link for link in links if not (ROOT / link).exists()]
    assert missing == []


def test_options_on_the_command_line_exist():
    from typer.main import get_command

    from fullturn.cli.main import build_app

    verbs = get_command(build_app()).commands
    options = {o for verb in verbs.values() for p in verb.params for o in p.opts}
    own = re.sub(r"`python benchmarks/[^`]*`", "", README)  # these have options of their own
    shown = set(re.findall(r"(?<=[ `])--[a-z][a-z-]*", own)) - {"--help"}
    assert shown <= options
    for verb in re.findall(r"fullturn ([a-z]+) ", "".join(re.findall(r"^    .*$", README, re.M))):
        assert verb in verbs


def test_make_targets_exist():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"^    make (\w+)", README, flags=re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE)


def test_every_documented_field_exists():
    from dataclasses import fields

    from fullturn import Registration

    table = README.split("## What you get")[1].split("\n## ")[0]
    shown = {
        name for row in re.findall(r"^\| (`.*?) \|", table, re.M) for name in row.split("`")[1::2]
    }
    assert shown == {field.name for field in fields(Registration)}


@pytest.fixture
def readme(monkeypatch):
    """The script that writes the measured numbers."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import readme

    return readme


def marked(readme, page: str, part: str) -> str:
    return readme.rewrite(page, part, readme.BEGIN, readme.END)


def test_measured_numbers_are_those_of_the_results(readme):
    assert marked(readme, README, readme.section(ROOT / "results")) == README


def test_full_tables_are_those_of_their_runs():
    from fullturn.evaluation.folders import read_runs
    from fullturn.evaluation.layout import markdown_section
    from fullturn.evaluation.tables import full_tables, main_table

    for path in (ROOT / "results").glob("*/tables.md"):
        sets = read_runs([path.parent])
        text = path.read_text(encoding="utf-8")
        for table in (main_table(sets), *full_tables(sets)):
            assert markdown_section(table) in text, path


def test_trained_tables_are_those_of_their_runs(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import trained_rows

    folder = ROOT / "results" / "trained"
    assert (folder / "README.md").read_text(encoding="utf-8") == trained_rows.page(folder)


def test_rewriting_twice_changes_nothing_and_keeps_the_rest(readme):
    old = f"before\n{readme.BEGIN}\nold\n{readme.END}\nafter\n"
    once = marked(readme, old, "new\n")
    assert once == f"before\n{readme.BEGIN}\nnew\n{readme.END}\nafter\n"
    assert marked(readme, once, "new\n") == once
    with pytest.raises(SystemExit, match="put them back"):
        marked(readme, "no marks", "new\n")


def test_what_is_missing_leaves_its_part_out(readme, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parent / "evaluation"))
    from run_folders import set_part, summary, write_run

    assert readme.section(tmp_path) == ""
    both = {"consensus": summary(), "kiss": summary(mean_deg=9.5, states=False)}
    both["gicp"] = summary(mean_deg=99.5, states=False)
    names = ("modelnet40/clean/180", "geotransformer/180", "modelnet40/noisy/45", "rpmnet/45")
    write_run(tmp_path / "modelnet", {name: set_part(both) for name in names})
    text = readme.section(tmp_path)
    assert "| clean | fullturn | 4 | 2.50 | 0.500 | 75.0 | 75.0 | 100.0 | 62.5 | 0.38 |" in text
    assert "|  | KISS-Matcher | 4 | 9.50 | 0.500 | 75.0 | 75.0 | 100.0 | – | 0.38 |" in text
    # Local methods stand where rotations are small alone.
    assert text.count("| GICP (small_gicp) |") == 1
    assert "| GICP (small_gicp) | 99.50°, 75.0 % |" in text
    assert "|  | GMCNet, as published | – | 0.036 |" in text
    assert "| method | one sample, noise (4) | two samples, 70 % kept (4) |" in text
    assert "| fullturn | 2.50°, 75.0 % | 2.50°, 75.0 % |" in text
    assert "| GMCNet, as published | 0.94° | – |" in text
    # What shares a sample and what doesn't never stand in one table of full rotations.
    tables = re.findall(r"(?:^\|.*\n)+", text, re.M)
    assert [("clean" in t, "cropped" in t) for t in tables[:2]] == [(True, False), (False, True)]
    assert "range scans" not in text
    assert "[All numbers" not in text

    (tmp_path / "modelnet" / "tables.md").write_text("")
    groups = {"overlap 0.3 to 0.6": both, "overlap below 0.1": both}
    write_run(tmp_path / "scans", {"stanford": set_part(both, groups=groups)})
    mixed = {"consensus": summary(unrelated=1, **{"unrelated_at_most_0.2": 1.0})}
    write_run(tmp_path / "calibration", {"mixture": set_part(mixed)})
    text = " ".join(readme.section(tmp_path).split())
    assert "(results/modelnet/tables.md)" in text
    assert "| overlap 30 to 60 % | fullturn | 4 | 2.50 |" in text
    assert "below 0.1" not in text
    # Of four pairs one is unrelated; three quarters of the others are right.
    assert "says 62.5 % on average and is right in 56.2 %" in text
    assert "Of the 1 pairs of different objects among them, 100.0 % get at most 0.2" in text


def test_the_map_of_the_paper_names_files_that_exist():
    text = (ROOT / "docs" / "paper-map.md").read_text(encoding="utf-8")
    paths = re.findall(r"`((?:src|tests|recipes)/[\w/.-]+)`", text)
    assert len(paths) > 40
    assert [path for path in paths if not (ROOT / path).exists()] == []
