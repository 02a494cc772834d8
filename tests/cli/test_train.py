"""`fullturn train` from the command line."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from fullturn.cli import main

RECIPE = """
[data]
shapes = [{ path = "procedural:6:3" }]
batch = 2
sample_points = 48
cloud_points = 36
[budget]
steps = 2
[validation]
every = 1
pairs = 2
share = 0.2
[machine]
device = "cpu"
threads = 1
"""


@pytest.fixture(autouse=True)
def _verb(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(main._VERBS, "train", "fullturn.cli.train")


@pytest.fixture
def recipe(tmp_path: Path) -> str:
    path = tmp_path / "tiny.toml"
    path.write_text(RECIPE)
    return str(path)


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main.build_app(), ["train", *arguments])


def test_a_recipe_becomes_a_folder(tmp_path: Path, recipe: str) -> None:
    out = tmp_path / "run"
    done = run(recipe, "data.batch=1", "--out", str(out))
    assert done.exit_code == 0, done.output
    assert "validation mean" in done.output
    assert str(out) in done.output
    names = {path.name for path in out.iterdir()}
    assert names >= {"weights.safetensors", "weights.md", "recipe.toml", "log.csv"}
    assert "batch = 1" in (out / "recipe.toml").read_text()
    again = run(recipe, "data.batch=1", "--out", str(out))
    assert again.exit_code == 1
    assert "--resume" in again.output
    longer = run(recipe, "data.batch=1", "--resume", "--out", str(out))
    assert longer.exit_code == 0, longer.output
    # Finished weights aren't written over where nothing is left to go on from.
    shutil.rmtree(out / "checkpoints")
    weights = (out / "weights.safetensors").read_bytes()
    (out / "recipe.toml").unlink()
    for options in (["--resume"], []):
        lost = run(recipe, "data.batch=1", *options, "--out", str(out))
        assert lost.exit_code == 1
        assert "found none; put them back" in lost.output
    assert (out / "weights.safetensors").read_bytes() == weights


def test_the_whole_recipe_can_be_shown(recipe: str) -> None:
    done = run(recipe, "optimizer.rate=0.5", "--show")
    assert done.exit_code == 0, done.output
    assert "rate = 0.5" in done.output
    assert "[model]" in done.output


def test_data_are_looked_for_in_a_folder(tmp_path: Path, recipe: str) -> None:
    place = "data.shapes=[{path='shapes.npz', part='train'}]"
    done = run(recipe, place, "--data", str(tmp_path), "--out", str(tmp_path / "run"))
    assert done.exit_code == 1
    assert "shapes.npz" in done.output
    assert len(done.output.strip().splitlines()) == 1
    (tmp_path / "shapes.npz").write_bytes(b"nonsense")
    done = run(recipe, place, "--data", str(tmp_path), "--out", str(tmp_path / "run"))
    assert f"{tmp_path}/shapes.npz" in done.output.replace("\n", "")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["missing.toml"], "missing.toml"),
        (["{recipe}:words"], "no words"),
        (["{recipe}", "batch"], "key=value"),
        (["{recipe}", "batch=3"], "unknown key"),
    ],
)
def test_known_errors_are_one_line(recipe: str, arguments: list[str], told: str) -> None:
    done = run(*(word.format(recipe=recipe) for word in arguments))
    assert done.exit_code == 1
    assert told in done.output
    assert len(done.output.strip().splitlines()) == 1


ENDLESS = """
import sys
from fullturn.cli import main
main._VERBS["train"] = "fullturn.cli.train"
sys.argv = ["fullturn", "train", *{arguments!r}]
main.main()
"""


def test_an_interrupted_run_says_how_to_go_on(tmp_path: Path, recipe: str) -> None:
    out = tmp_path / "run"
    arguments = [recipe, "budget.steps=100000", "--out", str(out)]
    child = subprocess.Popen(
        [sys.executable, "-c", ENDLESS.format(arguments=arguments)],
        stderr=subprocess.PIPE, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    limit = time.monotonic() + 60.0
    log = out / "validation.csv"
    while time.monotonic() < limit and not (log.exists() and len(log.read_text().splitlines()) > 2):
        time.sleep(0.02)
    child.send_signal(signal.SIGTERM)
    _, told = child.communicate(timeout=60)
    assert child.returncode == 130
    assert "--resume" in told.splitlines()[-1]
    assert "Traceback" not in told
    assert list((out / "checkpoints").glob("step-*.pt"))
