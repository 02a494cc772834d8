"""The demo writes what it says, with and without matplotlib, and tells its error honestly."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from fullturn.cli.demo import demo
from fullturn.errors import InputError, WriteError
from fullturn.evaluation.metrics import rotation_error_deg
from fullturn.io import load_cloud, read_transform

FILES = {"source.ply", "target.ply", "aligned.ply", "pose.txt", "report.html"}
# A quick local method: what is tested here is the demo, not the registration.
QUICK = ["--points", "400", "--method", "icp-point"]


@pytest.fixture
def run():
    app = typer.Typer()
    app.command()(demo)

    def call(*arguments: str):
        return CliRunner().invoke(app, [*arguments], catch_exceptions=False)

    return call


def test_it_writes_what_it_says(run, tmp_path):
    pytest.importorskip("matplotlib")
    out = tmp_path / "new" / "folder"
    done = run("--out", str(out), *QUICK)
    assert done.exit_code == 0
    assert {path.name for path in out.iterdir()} == FILES | {"demo.png"}
    T = read_transform(out / "pose.txt")
    source, aligned = (load_cloud(out / f"{name}.ply").points for name in ("source", "aligned"))
    np.testing.assert_allclose(aligned, source @ T[:3, :3].T + T[:3, 3], atol=1e-12)
    assert len(load_cloud(out / "target.ply").points) == 400


def test_the_error_is_measured_against_the_truth(run, tmp_path):
    from fullturn.cli.demo import DISTANCE, LEAST_OVERLAP, NOISE
    from fullturn.data.procedural import dog
    from fullturn.data.scan import scan_pair
    from fullturn.data.sensor import Sensor

    done = run("--out", str(tmp_path), "--seed", "3", *QUICK)
    told_deg = float(re.search(r"([\d.]+)° in rotation", done.output).group(1))
    rng = np.random.default_rng(3)
    sensor = Sensor(noise=NOISE / DISTANCE**2)
    pair = scan_pair(dog(), rng, points=400, min_overlap=LEAST_OVERLAP, sensor=sensor)
    found = read_transform(tmp_path / "pose.txt")
    assert told_deg == pytest.approx(rotation_error_deg(found, pair.T_target_source), abs=1e-3)


def test_without_matplotlib_only_the_picture_is_missing(run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    done = run("--out", str(tmp_path), *QUICK)
    assert done.exit_code == 0
    assert "fullturn[viz]" in done.output
    assert {path.name for path in tmp_path.iterdir()} == FILES


def test_the_same_seed_gives_the_same_scans(run, tmp_path):
    for name in ("a", "b"):
        run("--out", str(tmp_path / name), *QUICK)
    for name in ("source.ply", "target.ply", "pose.txt"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_a_folder_may_hold_an_earlier_demo_but_no_other_files_of_its_names(run, tmp_path):
    assert run("--out", str(tmp_path), *QUICK).exit_code == 0
    before = (tmp_path / "source.ply").read_bytes()
    assert run("--out", str(tmp_path), *QUICK, "--seed", "1").exit_code == 0
    assert (tmp_path / "source.ply").read_bytes() != before
    (tmp_path / "mine").mkdir()
    for name in ("notes.txt", "source.ply", "report.html"):
        (tmp_path / "mine" / name).write_text("mine")
    with pytest.raises(WriteError, match=r"found source\.ply, report\.html, which no earlier run"):
        run("--out", str(tmp_path / "mine"), *QUICK)
    assert {path.read_text() for path in (tmp_path / "mine").iterdir()} == {"mine"}


@pytest.mark.parametrize("method", ["nope", "nowhere.py"])
def test_an_unknown_method_leaves_no_folder(method, run, tmp_path):
    with pytest.raises(InputError, match=method):
        run("--out", str(tmp_path / "new"), "--method", method)
    assert not (tmp_path / "new").exists()


def test_an_unusable_folder_is_named(run, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match="cannot make the folder"):
        run("--out", str(tmp_path / "file"), *QUICK)
