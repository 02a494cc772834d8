"""`fullturn table` writes what it says, with and without matplotlib."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

sys.path.insert(0, str(Path(__file__).parents[1] / "evaluation"))

from run_folders import set_part, summary, write_run

from fullturn.cli.table import table
from fullturn.errors import ReadError, WriteError

TEXTS = {"tables.md", "tables.tex", "report.html"}
SETS = {
    "modelnet40/clean/180": set_part({"ours": summary(), "other": summary(states=False)}),
    "stanford": set_part({"ours": summary()}, groups={"near": {"ours": summary()}}),
}


@pytest.fixture
def run():
    app = typer.Typer()
    app.command()(table)

    def call(*arguments: object):
        return CliRunner().invoke(app, [*map(str, arguments)], catch_exceptions=False)

    return call


def test_it_writes_what_it_says(run, tmp_path):
    pytest.importorskip("matplotlib")
    folder, out = write_run(tmp_path / "run", SETS), tmp_path / "new" / "folder"
    done = run(folder, "--out", out)
    assert done.exit_code == 0
    assert {path.name for path in out.iterdir()} == TEXTS | {"curves.png", "risk_coverage.png"}
    assert re.search(
        r"^  ours +4 +2\.50 +0\.500 +75\.0 +75\.0 +100\.0 +62\.5 +0\.38$", done.output, re.M
    )
    assert re.search(r"^  GMCNet, as published +– +0\.036 ", done.output, re.M)
    assert "stanford: near" in done.output
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 2
    assert page.count("<table") == len(re.findall("^## ", (out / "tables.md").read_text(), re.M))
    assert (out / "tables.tex").read_text().count("\\begin{tabular}") == page.count("<table")


def test_the_page_needs_nothing_else(run, tmp_path):
    run(write_run(tmp_path / "run", SETS), "--out", tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"(src|href)=\"(?!data:)|url\(|@import|<script", page)
    assert "prefers-color-scheme: dark" in page


def test_two_runs_become_one_table(run, tmp_path):
    first = write_run(tmp_path / "a", SETS)
    second = write_run(tmp_path / "b", {"stanford": set_part({"third": summary()})})
    done = run(first, second, "--out", tmp_path)
    assert re.search(r"^stanford\n  ours .*\n  third ", done.output, re.M)


def test_the_same_runs_give_the_same_bytes(run, tmp_path):
    folder = write_run(tmp_path / "run", SETS)
    for name in ("a", "b"):
        run(folder, "--out", tmp_path / name)
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


def test_without_matplotlib_the_tables_are_there(run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    done = run(write_run(tmp_path / "run", SETS), "--out", tmp_path / "out")
    assert done.exit_code == 0
    assert "No figure was drawn" in done.output
    assert "fullturn[viz]" in done.output
    assert {path.name for path in (tmp_path / "out").iterdir()} == TEXTS


def test_without_rows_of_pairs_the_tables_are_there(run, tmp_path):
    folder = write_run(tmp_path / "run", SETS)
    for path in (folder / "pairs").iterdir():
        path.unlink()
    assert "no rows of pairs" in run(folder, "--out", tmp_path / "out").output


def test_errors_name_what_is_wrong(run, tmp_path):
    with pytest.raises(ReadError, match=r"summary\.json"):
        run(tmp_path, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match="cannot make the folder"):
        run(write_run(tmp_path / "run", SETS), "--out", tmp_path / "file")
