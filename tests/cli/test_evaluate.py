"""`fullturn evaluate` from the command line: one command, its files, its usage errors."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from fullturn.cli.main import build_app
from fullturn.data.draw import ProtocolPairs
from fullturn.data.frozen import freeze
from fullturn.data.protocols import PROTOCOLS
from fullturn.data.shapes import ProceduralShapes


def run(*arguments: str) -> Result:
    return CliRunner().invoke(build_app(), ["evaluate", *arguments])


def test_lists_of_methods_and_protocols_in_one_go(tmp_path: Path) -> None:
    done = run(
        "--method", "icp-point", "icp-plane",
        "--protocol", "modelnet40/clean/45", "rpmnet/45",
        "--shapes", "procedural:3", "--count", "2",
        "--workers", "1", "--cache", str(tmp_path / "cache"), "--out", str(tmp_path / "run"),
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert list(summary["methods"]) == ["icp-point", "icp-plane"]
    assert list(summary["sets"]) == ["modelnet40/clean/45", "rpmnet/45"]
    assert summary["sets"]["rpmnet/45"]["methods"]["icp-plane"]["n"] == 2
    assert "icp-plane" in done.output
    assert sorted(path.name for path in (tmp_path / "run" / "pairs").iterdir()) == [
        "modelnet40-clean-45.csv",
        "rpmnet-45.csv",
    ]


def test_frozen_pairs_are_a_set(tmp_path: Path) -> None:
    shapes = ProceduralShapes(2, seed=0)
    freeze(
        ProtocolPairs(PROTOCOLS["modelnet40/clean/45"], shapes, count=2), tmp_path / "frozen.npz"
    )
    done = run(
        "--method", "icp", "--pairs", str(tmp_path / "frozen.npz"),
        "--workers", "1", "--cache", str(tmp_path / "cache"), "--out", str(tmp_path / "run"),
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert [part["count"] for part in summary["sets"].values()] == [2]


BLIND = """
import torch
from fullturn.methods.base import Estimate, Method, Traits

class Blind(Method):
    name, summary, reference = "blind", "fails where it is told anything", "a test"
    traits = Traits(limits_rotation=True)
    def estimate(self, source, target, *, rng, max_rotation_rad=None):
        if any(x is not None for x in (source.viewpoint, target.viewpoint, max_rotation_rad)):
            raise ValueError("told")
        return Estimate(torch.eye(4, dtype=torch.float64)[None])
"""


def test_what_is_known_can_be_kept_back(tmp_path: Path) -> None:
    (tmp_path / "blind.py").write_text(BLIND)
    for options, failures in (((), 1), (("--blind",), 0)):
        done = run(
            "--method", f"{tmp_path / 'blind.py'}:Blind", "--protocol", "mvp-rg", "rpmnet/45",
            "--shapes", "procedural:1", "--count", "1", "--workers", "1",
            "--cache", str(tmp_path / "cache"), "--out", str(tmp_path / "run"), *options,
        )  # fmt: skip
        assert done.exit_code == 0, done.output
        summary = json.loads((tmp_path / "run" / "summary.json").read_text())
        suffix = "/blind" if options else ""
        assert list(summary["sets"]) == [f"mvp-rg{suffix}", f"rpmnet/45{suffix}"]
        for part in summary["sets"].values():
            assert part["methods"]["blind"]["errors"] == failures
            assert part["description"].get("known") == ("nothing" if options else None)
        assert summary["methods"]["blind"]["traits"]["limits_rotation"] is True
        (wide,) = (set(" ".join(done.output.split()).split("told that rotations are at most")[1:]),)
        assert bool(wide) is not bool(options)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--protocol", "rpmnet/45", "--shapes", "procedural"], "--method"),
        (["--method", "icp"], "--pairs"),
        (["--method", "icp", "--protocol", "rpmnet/45"], "--shapes"),
        (["--method", "icp", "--shapes", "procedural"], "--protocol"),
    ],
)
def test_wrong_usage(tmp_path: Path, arguments: list[str], told: str) -> None:
    done = run(*arguments, "--out", str(tmp_path / "run"))
    assert done.exit_code == 2
    assert told in done.output


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--method", "none", "--protocol", "rpmnet/45", "--shapes", "procedural"], "consensus"),
        (["--method", "icp", "--protocol", "none", "--shapes", "procedural"], "rpmnet/45"),
        (["--method", "icp", "--protocol", "rpmnet/45", "--shapes", "none"], "procedural"),
        (["--method", "icp", "--pairs", "nonsense.npz"], "nonsense.npz"),
    ],
)
def test_unknown_names_are_told_what_there_is(
    tmp_path: Path, arguments: list[str], told: str
) -> None:
    done = run(*arguments, "--out", str(tmp_path / "run"), "--cache", str(tmp_path / "cache"))
    assert done.exit_code == 1
    assert told in done.output
    assert len(done.output.strip().splitlines()) == 1
    assert not (tmp_path / "run").exists()
