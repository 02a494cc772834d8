"""`fullturn fuse`: files, table, one JSON object, errors of one line."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from fullturn.cli.main import build_app
from fullturn.io import load_cloud, save_cloud

pytest.importorskip("gtsam")


@pytest.fixture
def files(tmp_path: Path) -> list[str]:
    """Three scans nearly aligned, so that plain ICP registers them."""
    u = np.random.default_rng(0).normal(size=(600, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    cloud = u * (1 + 0.3 * np.sin(3 * u[:, :1] + 1) + 0.2 * u[:, 1:2] * u[:, 2:]) * (1.0, 0.8, 0.6)
    paths = []
    for number in range(3):
        R = Rotation.from_rotvec([0.1 * number, -0.05, 0.02 * number]).as_matrix()
        paths.append(str(tmp_path / f"scan{number}.ply"))
        save_cloud(paths[-1], cloud[: 600 - 5 * number] @ R.T + number)
    return paths


def call(*arguments: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(build_app(), ["fuse", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


def test_outputs_and_one_json_object(files: list[str], tmp_path: Path) -> None:
    merged, poses, report = (tmp_path / name for name in ("m.ply", "poses.json", "r.html"))
    options = ["--method", "icp-point", "--min-probability", 0.01, "--workers", 1, "--json"]
    options += ["--cache", tmp_path / "cache", "--poses", poses, "--report", report]
    code, out, _ = call(*files, "--out", merged, *options)
    assert code == 0
    content = json.loads(out)
    assert [scan["path"] for scan in content["scans"]] == files
    assert content["points"] == len(load_cloud(merged).points)
    assert json.loads(poses.read_text())["scans"] == content["scans"]
    # Everything counts from 0: the group is a place in `groups`, `chosen` one in `probability`.
    assert [scan["group"] for scan in content["scans"]] == [0, 0, 0]
    assert content["groups"] == [files]
    assert {edge["chosen"] for edge in content["edges"]} == {0}
    assert report.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert len(content["edges"]) == 3
    assert (tmp_path / "cache" / "edges.jsonl").exists()


def test_people_get_a_table(files: list[str], tmp_path: Path) -> None:
    code, out, _ = call(
        *files, "--out", tmp_path / "m.xyz", "--method", "icp-point", "--workers", 1
    )
    assert code == 0
    for word in ("scan0.ply", "scan2.ply", "probability", "group", "points in"):
        assert word in out


def test_viewpoints_are_read_from_a_file(files: list[str], tmp_path: Path) -> None:
    eyes = tmp_path / "eyes.txt"
    options = ["--out", tmp_path / "m.xyz", "--method", "icp-point", "--workers", 1]
    eyes.write_text("0 0 5\n-\n\n1, 2, 3\n")
    assert call(*files, *options, "--viewpoints", eyes)[0] == 0
    eyes.write_text(eyes.read_text(encoding="utf-8"), encoding="utf-16")
    assert call(*files, *options, "--viewpoints", eyes)[0] == 0
    for text, message in (
        ("0 0 5\n", "a line for each of 3 scans, got 1"),
        ("0 0 5\n-\n1 2\n", "line 3: expected three numbers"),
        ("0 0 5\n-\n1 2 nan\n", "line 3: expected three numbers"),
    ):
        eyes.write_text(text)
        code, _, err = call(*files, *options, "--viewpoints", eyes)
        assert code == 1
        assert message in err
    code, _, err = call(*files, *options, "--viewpoints", tmp_path / "none.txt")
    assert code == 1
    assert "cannot read the viewpoints" in err


def test_the_documented_fields_are_those_there_are(files: list[str], tmp_path: Path) -> None:
    code, out, _ = call(
        *files, "--out", tmp_path / "m.npy", "--method", "icp-point", "--workers", 1, "--json"
    )
    assert code == 0
    content = json.loads(out)
    inner = [*content["scans"][0], *content["edges"][0]]
    text = (Path(__file__).parents[2] / "docs" / "fuse.md").read_text(encoding="utf-8")
    table = text.split("| field | type |")[1].split("\n\n")[0]
    rows = [line.split("|")[1] for line in table.splitlines()[2:]]
    documented = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    assert sorted(documented) == sorted([*content, *inner])


def test_every_group_is_written_and_counted_and_what_was_there_before_is_named(
    files: list[str], tmp_path: Path
) -> None:
    rng = np.random.default_rng(1)
    box = rng.uniform(-1, 1, (600, 3)) * (2.0, 0.3, 0.5)
    box[np.arange(600), rng.integers(0, 3, 600)] = 0.5
    for number in range(3):
        files.append(str(tmp_path / f"box{number}.ply"))
        save_cloud(files[-1], box[: 600 - 5 * number] + 50.0 + 0.1 * number)
    (tmp_path / "m_group3.ply").write_text("of another run")
    options = ["--method", "icp-point", "--min-probability", 0.01, "--workers", 1]
    code, out, err = call(*files, "--out", tmp_path / "m.ply", *options)
    assert code == 0
    written = [tmp_path / name for name in ("m.ply", "m_group2.ply")]
    points = sum(len(load_cloud(path).points) for path in written)
    assert f"{points:,} points in" in out
    assert "m_group3.ply was there before" in " ".join(err.split())
    assert (tmp_path / "m_group3.ply").read_text() == "of another run"


@pytest.mark.parametrize("value", ["nan", "0", "1.5"])
def test_a_probability_out_of_range_is_wrong_usage(value: str, tmp_path: Path) -> None:
    code, _, err = call("a.ply", "b.ply", "--out", tmp_path / "m.ply", "--min-probability", value)
    assert code == 2
    assert "--min-probability" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{scan}", "--out", "{folder}/m.ply"], "at least 2"),
        (["{scan}", "{scan}", "--out", "{folder}/m.ply"], "same points"),
        (["{scan}", "{folder}/none.ply", "--out", "{folder}/m.ply"], "there is none"),
        (["{scan}", "{scan}", "--out", "{folder}/m.jpg"], ".ply, .npy"),
        (["{scan}", "{folder}/scan1.ply", "--out", "{folder}/./scan1.ply"], "is an input"),
        (["{scan}"] * 3 + ["{folder}/m_group2.ply", "--out", "{folder}/m.ply"], "is an input"),
        (["{scan}", "{scan}", "--out", "{folder}/m.ply", "--poses", "p.txt"], ".json"),
    ],
)
def test_known_errors_are_one_line(
    arguments: list[str], message: str, files: list[str], tmp_path: Path
) -> None:
    filled = [word.format(scan=files[0], folder=tmp_path) for word in arguments]
    code, out, err = call(*filled)
    assert (code, out) == (1, "")
    assert message in err
    assert err.count("\n") == 1
    assert not (tmp_path / "m.ply").exists()
