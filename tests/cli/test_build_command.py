"""`fullturn build mvp-rg` from the command line: its folder, its line, its errors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from fullturn.cli.main import build_app
from fullturn.data.mvp_build import build_mvp_rg
from fullturn.data.mvp_rg import MvpRgConfig
from fullturn.data.open import open_pairs
from fullturn.data.shapes import ProceduralShapes


def run(*arguments: str) -> Result:
    return CliRunner().invoke(build_app(), ["build", *arguments])


def test_worker_processes_make_the_same_bytes(tmp_path: Path) -> None:
    out = tmp_path / "set"
    command = (
        "mvp-rg", "--shapes", "procedural:4:1", "procedural:4:2", "--out", str(out),
        "--train", "3", "--test", "1", "--rotation", "released", "--seed", "2", "--workers", "2",
    )  # fmt: skip
    done = run(*command)
    assert done.exit_code == 0, done.output
    assert f"{out}: 3 train pairs of " in done.output.replace("\n", " ")
    config = MvpRgConfig(train=3, test=1, rotation="released", seed=2)
    build_mvp_rg([ProceduralShapes(4, 1), ProceduralShapes(4, 2)], tmp_path / "here", config)
    for path in (tmp_path / "here").iterdir():
        assert path.read_bytes() == (out / path.name).read_bytes(), path.name
    assert len(open_pairs(out)) == 1
    again = run(*command)
    assert again.exit_code == 0, again.output
    other = run(*command, "--min-overlap", "0.4")
    assert other.exit_code == 1
    assert "config.min_overlap: 0.3 there, 0.4 asked for" in other.output.replace("\n", " ")


def test_test_shapes_may_be_given(tmp_path: Path) -> None:
    done = run(
        "mvp-rg", "--shapes", "procedural:2:1", "--test-shapes", "procedural:1:9",
        "--out", str(tmp_path / "set"), "--train", "1", "--test", "1", "--workers", "1",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    manifest = json.loads((tmp_path / "set" / "manifest.json").read_text())
    assert [one["seed"] for one in manifest["plan"]["test_shapes"]] == [9]
    assert open_pairs(tmp_path / "set").pair(0).name.startswith("procedural_9_")


def test_the_sensor_is_a_rule_of_the_set(tmp_path: Path) -> None:
    out = tmp_path / "set"
    command = (
        "mvp-rg", "--shapes", "procedural:2:1", "--out", str(out), "--train", "0", "--test", "1",
        "--workers", "1", "--noise", "0.001", "--quantize", "0.0005", "--grazing", "10",
        "--flying", "0.1", "--holes", "2",
    )  # fmt: skip
    assert run(*command).exit_code == 0
    sensor = json.loads((out / "manifest.json").read_text())["plan"]["config"]["sensor"]
    options = (sensor["noise"], sensor["quantize"], sensor["grazing_deg"], sensor["flying"])
    assert options == (0.001, 0.0005, 10.0, 0.1)
    assert sensor["holes"] == 2
    plain = tmp_path / "plain"
    assert run(*(str(plain) if part == str(out) else part for part in command[:-10])).exit_code == 0
    sensed, exact = (open_pairs(folder).pair(0).source for folder in (out, plain))
    assert not np.array_equal(sensed, exact)


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        (["--shapes", "procedural:2"], 2, "--out"),
        (["--out", "x"], 2, "--shapes"),
        (["--shapes", "procedural:2", "--out", "x", "--rotation", "half"], 2, "--rotation"),
        (["--shapes", "procedural:2", "--out", "x", "--train", "0", "--test", "0"], 1, "more than"),
        (["--shapes", "procedural:1", "--out", "x"], 1, "another one to test on"),
        (["--shapes", "absent.npz", "--out", "x"], 1, "absent.npz"),
        (["--shapes", "points.npz", "--out", "x"], 1, "expected meshes, which a camera can see"),
    ],
)
def test_wrong_uses_leave_no_folder(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    code: int,
    told: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    np.savez(
        "points.npz",
        points=np.ones((2, 4096, 3), dtype=np.int16),
        scale=np.int64(30000),
        name=np.array(["a", "b"]),
        cls=np.array(["chair", "vase"]),
        use=np.array(["dev_eval", "train"]),
    )
    done = run("mvp-rg", *arguments)
    assert done.exit_code == code, done.output
    assert told in " ".join(done.output.split())
    assert not (tmp_path / "x").exists()


def test_another_dataset_is_wrong_usage(tmp_path: Path) -> None:
    done = run("shapenet", "--shapes", "procedural:2", "--out", str(tmp_path / "x"))
    assert done.exit_code == 2
