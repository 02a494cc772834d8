"""Importing fullturn and asking for help stay quick, and never import torch."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest


def run(code: str, *, times: int = 3) -> tuple[str, float]:
    """Output and the least CPU time of fresh interpreters: a busy machine is no slow import."""
    seconds = []
    for _ in range(times):
        before = _cpu_seconds_of_children()
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        )
        seconds.append(_cpu_seconds_of_children() - before)
    return done.stdout, min(seconds)


def _cpu_seconds_of_children() -> float:
    times = os.times()
    return times.children_user + times.children_system


def test_importing_fullturn_is_quick() -> None:
    _, bare = run("pass")
    out, loaded = run("import sys, fullturn; print('torch' in sys.modules)")
    assert out.strip() == "False"
    assert loaded - bare < 0.3


HELP = """
import sys
from fullturn.cli.main import main
sys.argv = ["fullturn", *{arguments!r}]
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
heavy = ("torch", "numpy", "scipy", "trimesh", "matplotlib")
print([name for name in heavy if name in sys.modules])
"""


@pytest.mark.parametrize("arguments", [["--help"], ["register", "--help"], ["--version"]])
def test_help_is_quick_and_imports_nothing_heavy(arguments: list[str]) -> None:
    _, bare = run("pass")
    _, needed = run("import typer.rich_utils")
    out, seconds = run(HELP.format(arguments=arguments))
    assert out.splitlines()[-1] == "[]"
    # What draws any help has to be imported: machines differ, but this ratio hardly does.
    assert seconds - bare < 4 * (needed - bare)


def test_the_public_names_are_there_and_lazy() -> None:
    code = "import fullturn; print([getattr(fullturn, n) is not None for n in fullturn.__all__])"
    assert "False" not in run(code, times=1)[0]


def test_reading_files_needs_no_torch() -> None:
    code = "import sys, fullturn.io; fullturn.io.load_cloud; print('torch' in sys.modules)"
    assert run(code, times=1)[0].strip() == "False"
