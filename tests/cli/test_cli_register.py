"""The command line: outputs, exit codes, and errors of one line."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import fullturn
from fullturn.cli.main import build_app
from fullturn.io import load_cloud, read_transform, save_cloud

R_TRUE = Rotation.from_rotvec([0.1, -0.2, 0.15]).as_matrix()


@pytest.fixture
def files(tmp_path: Path) -> list[str]:
    u = np.random.default_rng(0).normal(size=(300, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    cloud = u * (1 + 0.3 * np.sin(3 * u[:, :1] + 1) + 0.2 * u[:, 1:2] * u[:, 2:]) * (1.0, 0.8, 0.6)
    save_cloud(tmp_path / "source.ply", np.vstack([cloud, [[np.nan] * 3]]))
    save_cloud(tmp_path / "target.xyz", cloud @ R_TRUE.T + 2.0)
    return [str(tmp_path / "source.ply"), str(tmp_path / "target.xyz"), "--method", "icp-point"]


def call(*arguments: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(build_app(), [str(a) for a in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


def no_work(*_: object, **__: object) -> None:
    raise AssertionError("worked")


def test_people_get_a_table(files: list[str]) -> None:
    code, out, err = call("register", *files)
    assert code == 0
    assert err == ""
    for word in ("rotation", "15.4", "translation", "probability", "overlap", "seconds"):
        assert word in out
    assert "dropped 1 of 301 points" in " ".join(out.split())


def test_programs_get_one_json_object(files: list[str]) -> None:
    code, out, err = call("register", *files, "--json", "--seed", "3")
    assert (code, err) == (0, "")
    content = json.loads(out)
    np.testing.assert_allclose(np.array(content["T_target_source"])[:3, :3], R_TRUE, atol=1e-6)
    assert 0.0 <= content["success_probability"] <= 1.0
    assert len(content["overlap"]) == 2
    assert content["method"] == "icp-point"
    assert content["seconds"]["total"] > 0.0
    assert content["alternatives"] == []
    assert content["symmetry"] is None
    assert np.array(content["covariance"]).shape == (6, 6)
    assert "dropped 1 of 301 points" in content["notes"][0]


def test_outputs_hold_the_result_exactly(files: list[str], tmp_path: Path) -> None:
    text, as_json, moved = tmp_path / "T.txt", tmp_path / "T.json", tmp_path / "moved.ply"
    code, out, _ = call("register", *files, "--json", "--out", text, "--save", moved)
    assert code == 0
    T = np.array(json.loads(out)["T_target_source"])
    np.testing.assert_array_equal(read_transform(text), T)
    np.testing.assert_allclose(load_cloud(moved).points, load_cloud(files[1]).points, atol=1e-6)
    assert call("register", *files, "--out", as_json)[0] == 0
    np.testing.assert_array_equal(read_transform(as_json), T)


def test_what_cannot_be_written_is_told_before_the_work(
    files: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fullturn.api.register", no_work)
    for option, place in (("--out", "/proc/x.txt"), ("--save", f"/tmp/{'long' * 100}.ply")):
        code, out, err = call("register", *files, option, place)
        assert (code, out) == (1, "")
        assert f"cannot write {place[:100]}" in err


def test_a_picture_that_cannot_be_drawn_is_told_before_the_work(
    files: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fullturn.api.register", no_work)
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    outputs = ["--figure", tmp_path / "a.png", "--report", tmp_path / "a.html"]
    code, out, err = call("register", *files, *outputs)
    assert (code, out) == (1, "")
    assert "fullturn[viz]" in err


def test_too_little_memory_is_one_line(files: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def too_much(*_: object, **__: object) -> None:
        raise MemoryError("Unable to allocate 21.8 TiB")

    monkeypatch.setattr("fullturn.api.register", too_much)
    code, out, err = call("register", *files)
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert "Unable to allocate 21.8 TiB; ask for less" in err


def test_report_and_figure(files: list[str], tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    report, figure = tmp_path / "a.html", tmp_path / "a.png"
    assert call("register", *files, "--report", report, "--figure", figure)[0] == 0
    assert "source.ply" in report.read_text(encoding="utf-8")
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert call("register", *files, "--figure", tmp_path / "a.pdf")[0] == 0


@pytest.mark.parametrize("name", ["a.tiff", "a"])
def test_a_picture_of_another_kind_is_refused_before_the_work(
    name: str, files: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fullturn.api.register", no_work)
    code, _, err = call("register", *files, "--figure", tmp_path / name)
    assert code == 1
    assert "expected a file name that ends in one of .png, .pdf, .svg, .jpg, .jpeg, found" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.ply", "also.ply"], "there is none"),
        (["{source}", "{target}", "--method", "magic"], "expected auto, icp, consensus"),
        (["{source}", "{target}", "--method", "magic"], "gmcnet@WEIGHTS[+consensus], or your own"),
        (["{source}", "{target}", "--out", "T.yaml"], ".txt, .json"),
        (["{source}", "{target}", "--out", "missing/T.txt"], "create it first"),
        (["{source}", "{target}", "--save", "a.jpg"], ".ply, .npy"),
        (["{source}", "{target}", "--report", "a.pdf"], ".html"),
        (["{source}", "{target}", "--figure", "a.gif"], ".png"),
        (["{source}", "{target}", "--out", "a.txt", "--save", "./a.txt"], "got this one twice"),
        (["{source}", "{source}/x"], "there is none"),
        (["{source}", "{target}", "--max-rotation", "45", "--method", "icp"], "(consensus, "),
    ],
)
def test_known_errors_are_one_line_and_exit_with_1(
    arguments: list[str], message: str, files: list[str]
) -> None:
    filled = [a.format(source=files[0], target=files[1]) for a in arguments]
    code, out, err = call("register", *filled)
    assert code == 1
    assert out == ""
    assert err.startswith("fullturn: error: ")
    assert message in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "arguments",
    [
        ["register"],
        ["register", "a.ply"],
        ["nothing"],
        ["register", "a.ply", "b.ply", "--wrong"],
        ["register", "a.ply", "b.ply", "--seed", "-1"],
        ["register", "a.ply", "b.ply", "--seed", "x"],
        ["register", "a.ply", "b.ply", "--min-probability", "2"],
        ["register", "a.ply", "b.ply", "--min-probability", "nan"],
        ["register", "a.ply", "b.ply", "--source-viewpoint", "1,2"],
        ["register", "a.ply", "b.ply", "--target-viewpoint", "1,2,inf"],
        ["register", "a.ply", "b.ply", "--max-rotation", "0"],
        ["register", "a.ply", "b.ply", "--max-rotation", "180.5"],
        ["register", "a.ply", "b.ply", "--max-rotation", "-45"],
        ["register", "a.ply", "b.ply", "--max-rotation", "nan"],
        ["register", "a.ply", "b.ply", "--max-rotation", "x"],
        ["register", "a.ply", ""],
        ["demo", "--out", "", "--method", "icp-point"],
        ["demo", "--out=", "--method", "icp-point"],
    ],
)
def test_wrong_usage_exits_with_2(arguments: list[str]) -> None:
    code, out, err = call(*arguments)
    assert (code, out) == (2, "")
    assert err


def test_below_the_minimum_exits_with_3_and_still_answers(files: list[str], tmp_path: Path) -> None:
    save_cloud(tmp_path / "other.npy", np.random.default_rng(1).uniform(-9, 9, size=(300, 3)))
    clouds = [files[0], tmp_path / "other.npy", *files[2:]]
    options = ["--json", "--min-probability", "0.9", "--out", tmp_path / "T.txt"]
    code, out, err = call("register", *clouds, *options)
    assert code == 3
    assert json.loads(out)["success_probability"] < 0.9
    assert "below the --min-probability 0.9" in err
    assert (tmp_path / "T.txt").exists()
    assert call("register", *clouds, "--min-probability", "0")[0] == 0


def test_viewpoints_may_begin_with_a_minus(files: list[str]) -> None:
    code, _, err = call("register", *files, "--source-viewpoint", "-1,2,3.5")
    assert (code, err) == (0, "")


LIMITED = """
import math
import torch
from fullturn.methods.base import Estimate, Method, Traits

class Limited(Method):
    name, summary, reference = "limited", "tells what it was told", "this test"
    traits = Traits(limits_rotation=True)
    def estimate(self, source, target, *, rng, max_rotation_rad=None):
        told = {"told": math.degrees(max_rotation_rad)}
        return Estimate(torch.eye(4).double()[None], torch.tensor([0.5]), seconds=told)
"""


def test_the_largest_rotation_reaches_the_method(files: list[str], tmp_path: Path) -> None:
    (tmp_path / "limited.py").write_text(LIMITED)
    method = f"{tmp_path / 'limited.py'}:Limited"
    code, out, _ = call(
        "register", *files[:2], "--method", method, "--max-rotation", "62.5", "--json"
    )
    assert code == 0
    assert json.loads(out)["seconds"]["told"] == pytest.approx(62.5)


def test_version_and_methods() -> None:
    assert call("--version")[:2] == (0, f"fullturn {fullturn.__version__}\n")
    code, out, _ = call("methods")
    assert code == 0
    assert "consensus (auto)" in out
    assert "icp-plane (icp)" in out
    assert "gmcnet@WEIGHTS" in out


WAIT = """
import sys, time
import fullturn.api

def register(*_, **__):
    print("at work", flush=True)
    time.sleep(60)

fullturn.api.register = register
from fullturn.cli.main import main
sys.argv = ["fullturn", "register", *sys.argv[1:]]
main()
"""


def test_a_real_interrupt_exits_with_130(files: list[str]) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", WAIT, *files],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert process.stdout is not None
    assert process.stdout.readline().strip() == "at work"
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert err == "fullturn: interrupted\n"


def test_output_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    command = [sys.executable, "-c", "from fullturn.cli.main import main; main()", "methods"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert "cannot write the output" in done.stderr
