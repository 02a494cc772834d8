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


def test_measured_numbers_are_those_of_the_results(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import tables

    assert tables.rewrite(README, tables.section(ROOT / "results")) == README
