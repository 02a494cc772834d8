"""`fullturn batch`: what it prints, its exit codes, and Ctrl-C."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from batch_cases import SMALLEST, asked, write_method, write_pairs
from typer.testing import CliRunner

from fullturn.cli.main import build_app

pytest.importorskip("distributed")
pq = pytest.importorskip("pyarrow.parquet")

MAIN = "from fullturn.cli.main import main; main()"


def call(*arguments: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(build_app(), ["batch", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


def test_ctrl_c_keeps_finished_parts_and_the_same_command_goes_on(tmp_path: Path) -> None:
    pairs, method, out = write_pairs(tmp_path, 12), write_method(tmp_path), tmp_path / "out"
    (tmp_path / "target11.npy").unlink()
    arguments = [str(pairs), "--out", str(out), "--workers", "1", "--part-size", "1"]
    arguments += ["--method", method]
    with subprocess.Popen(
        [sys.executable, "-c", MAIN, "batch", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    ) as process:
        deadline = time.monotonic() + 60
        while not list(out.glob("part-*.parquet")) and time.monotonic() < deadline:
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the whole group
        _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.splitlines()[-1] == "fullturn: interrupted"
    assert "Traceback" not in err
    finished = len(list(out.glob("part-*.parquet")))
    assert 0 < finished < 12

    started = asked(tmp_path)
    code, printed, _ = call(*arguments, "--retry-failed")
    assert code == 0
    failed, last = printed.splitlines()
    assert failed.startswith("failed: pair 11: ")
    assert "target11.npy" in failed
    assert last.startswith(f"11 done, 1 failed, {finished} of them by an earlier run; ")
    assert last.endswith(f"results in {out}")
    # One pair was at work when it was interrupted, at most one more waited beside it.
    assert len(asked(tmp_path)) - 11 <= 2 + len(started) - len(set(started))
    assert set(asked(tmp_path)) == {SMALLEST + n for n in range(11)}
    assert pq.read_table(out)["id"].to_pylist() == [f"pair {n}" for n in range(12)]


@pytest.mark.parametrize(
    ("rows", "options", "message"),
    [
        ("", [], "at least one pair"),
        ("1,a,b\n1,c,d\n", [], "line 3, column id"),
        ("1,a,b\n", ["--method", "none"], "method: expected"),
        ("1,a,b\n", ["--scheduler", "tcp://127.0.0.1:1"], "scheduler: expected the address"),
        ("1,a,b\n", ["--method", "icp", "--seed", "1"], "expected results of these pairs"),
    ],
)
def test_known_errors_are_one_line(
    rows: str, options: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fullturn.cluster.client._CONNECT_SECONDS", 0.5)
    out = tmp_path / "out"
    if "--seed" in options:
        out.mkdir()
        (out / "_batch.json").write_text("{}")
        (out / "part-000000.parquet").touch()
    (tmp_path / "pairs.csv").write_text("id,source,target\n" + rows)
    code, printed, err = call(tmp_path / "pairs.csv", "--out", out, *options)
    assert (code, printed) == (1, "")
    assert message in err
    assert err.count("\n") == 1


def test_wrong_usage(tmp_path: Path) -> None:
    code, _, err = call("pairs.csv", "--out", tmp_path, "--workers", 2, "--scheduler", "tcp://a:1")
    assert code == 2
    assert "at most one of them" in err


@pytest.mark.parametrize("package", ["distributed", "pyarrow"])
def test_a_missing_package_names_the_extra(
    package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from importlib.util import find_spec

    monkeypatch.setattr(
        "fullturn.cluster.client.find_spec",
        lambda name: None if name == package else find_spec(name),
    )
    code, _, err = call(tmp_path / "pairs.csv", "--out", tmp_path / "out")
    assert code == 1
    assert (
        f'expects {package}, not installed; install it with pip install "fullturn[cluster]"' in err
    )
