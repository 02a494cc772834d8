"""`fullturn study` writes its table and picture, and names what it doesn't know."""

from __future__ import annotations

import csv
import sys

import pytest
import typer
from typer.testing import CliRunner

from fullturn.cli.study import study
from fullturn.errors import InputError, WriteError

QUICK = ["--shapes", "procedural:2:5", "--count", "1"]


@pytest.fixture
def run():
    app = typer.Typer()
    app.command()(study)

    def call(*arguments: str, catch: bool = False):
        return CliRunner().invoke(app, [*arguments], catch_exceptions=catch)

    return call


def test_one_command_makes_the_table_and_the_picture(run, tmp_path):
    pytest.importorskip("matplotlib")
    out = tmp_path / "new" / "folder"
    done = run("robustness", *QUICK, "--out", str(out))
    assert done.exit_code == 0
    assert {path.name for path in out.iterdir()} == {"robustness.csv", "robustness.png"}
    with (out / "robustness.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    flat = [
        float(row["value"]) for row in rows if (row["panel"], row["feature"]) == ("rotation", "RRI")
    ]
    assert len(flat) == 10
    assert min(flat) >= 0.999


def test_the_same_seed_gives_the_same_bytes(run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    for name in ("a", "b"):
        done = run("robustness", *QUICK, "--seed", "3", "--out", str(tmp_path / name))
        assert "fullturn[viz]" in done.output
        assert [path.name for path in (tmp_path / name).iterdir()] == ["robustness.csv"]
    files = [(tmp_path / name / "robustness.csv").read_bytes() for name in ("a", "b")]
    assert files[0] == files[1]


def test_an_unknown_study_lists_the_known_ones(run, tmp_path):
    done = run("strength", *QUICK, "--out", str(tmp_path / "out"))
    assert done.exit_code == 2
    assert "expected one of robustness; got 'strength'" in " ".join(done.output.split())
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_used_is_named(run, tmp_path):
    with pytest.raises(InputError, match="procedural:none"):
        run("robustness", "--shapes", "procedural:none", "--out", str(tmp_path / "out"))
    assert not (tmp_path / "out").exists()
    with pytest.raises(InputError, match="at most the 2048 points of a shape, got 3000"):
        run("robustness", *QUICK, "--neighbors", "3000", "--out", str(tmp_path / "out"))
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match="cannot make the folder"):
        run("robustness", *QUICK, "--out", str(tmp_path / "file"))
