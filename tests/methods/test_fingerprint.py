from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

import fullturn
from fullturn.methods import fingerprint as module
from fullturn.methods.fingerprint import ESTIMATE, REGISTER, _closure, fingerprint
from fullturn.methods.registry import get

OWN = """
import numpy as np
from fullturn.methods.base import Method

class Own(Method):
    name, summary, reference = "own", "nothing", "this test"
    def estimate(self, source, target, *, rng):
        return {answer}
"""


def own(path: Path, answer: str) -> str:
    path.write_text(OWN.format(answer=answer))
    return fingerprint(get(f"{path}:Own"))[0]


def test_the_closure_is_what_the_answer_depends_on() -> None:
    files, packages = _closure(get("consensus"), ESTIMATE)
    names = {path.relative_to(Path(fullturn.__file__).parent).as_posix() for path in files}
    assert {
        "methods/consensus.py", "pose/search.py", "pose/verify.py", "geometry/neighbors.py",
        "features/surface.py", "normalize.py", "weights/verdict.safetensors",
    } <= names  # fmt: skip
    assert not {name for name in names if name.startswith(("cli", "viz", "evaluation", "data"))}
    assert "methods/classical/icp.py" not in names
    assert {"torch", "numpy", "small_gicp"} <= packages


def test_what_a_module_imports_beside_it_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home = tmp_path / "outer_of_mine" / "inner"
    home.mkdir(parents=True)
    for folder in (home, home.parent):
        (folder / "__init__.py").touch()
    (home / "mine.py").write_text(
        "from . import beside\nfrom ..above import GAIN\n" + OWN.format(answer="1")
    )
    for helper in (home / "beside.py", home.parent / "above.py"):
        helper.write_text("GAIN = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    method = importlib.import_module("outer_of_mine.inner.mine").Own
    seen = [fingerprint(method)[0]]
    for helper in (home / "beside.py", home.parent / "above.py"):
        helper.write_text("GAIN = 2\n")
        seen.append(fingerprint(method)[0])
    assert len(set(seen)) == 3


def test_what_lies_beside_an_own_file_counts_and_what_is_installed_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counts = ["near_mine.py", "kit_of_mine/__init__.py", "kit_of_mine/deep/tool.py",
              "kit_of_mine/deep/gain.py", "bare_of_mine/tool.py"]  # fmt: skip
    installed = "site-packages/far_from_mine.py"
    for name in (*counts, installed):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("GAIN = 1\n")
    (tmp_path / "near_mine.py").write_bytes("# coding: latin-1\nGAIN = 'ü'\n".encode("latin-1"))
    (tmp_path / "kit_of_mine/deep/tool.py").write_text("from .gain import GAIN\n")
    (tmp_path / "mine.py").write_text(
        "from near_mine import *\nimport kit_of_mine.deep.tool\nfrom bare_of_mine import tool\n"
        "import far_from_mine\n"
        "try:\n    from . import near_mine\nexcept ImportError:\n    pass\n"
        + OWN.format(answer="1")
    )
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path / "site-packages")])
    method = get(f"{tmp_path / 'mine.py'}:Own")
    seen = [fingerprint(method)[0]]
    for name in (*counts, installed):
        (tmp_path / name).write_bytes((tmp_path / name).read_bytes() + b"# changed\n")
        seen.append(fingerprint(method)[0])
    assert len(set(seen)) == 1 + len(counts)
    assert seen[-1] == seen[-2]


@pytest.mark.parametrize(
    "name", ["verdict.safetensors", "evidence.safetensors", "confidence.safetensors", "api.py"]
)
def test_what_register_adds_counts_where_it_is_a_root(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A method that states no probability: the front door asks the verdict.
    found = {roots: fingerprint(get("icp-point"), roots=roots)[0] for roots in (ESTIMATE, REGISTER)}
    honest = Path.read_bytes
    monkeypatch.setattr(
        Path, "read_bytes", lambda path: b"refit" if path.name == name else honest(path)
    )
    assert fingerprint(get("icp-point"))[0] == found[ESTIMATE]
    assert fingerprint(get("icp-point"), roots=REGISTER)[0] != found[REGISTER]


def test_versions_are_named_and_count() -> None:
    code, versions = fingerprint(get("icp-point"))
    assert {"torch", "numpy", "small_gicp"} <= set(versions)
    assert fingerprint(get("icp-point"))[0] == code != fingerprint(get("icp-plane"))[0]


def test_every_process_says_the_same() -> None:
    script = (
        "from fullturn.methods.fingerprint import fingerprint\n"
        "from fullturn.methods.registry import get\n"
        "print(fingerprint(get('consensus'))[0])"
    )
    found = {
        subprocess.run(
            [sys.executable, "-c", script],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True, text=True, check=True,
        ).stdout.strip()
        for seed in ("1", "2", "3")
    }  # fmt: skip
    assert found == {fingerprint(get("consensus"))[0]}


def test_a_changed_package_is_another_method(monkeypatch) -> None:
    code, _ = fingerprint(get("icp-point"))
    monkeypatch.setattr(module.metadata, "version", lambda name: "0")
    assert fingerprint(get("icp-point"))[0] != code


def test_a_changed_file_is_another_method(tmp_path: Path) -> None:
    first = own(tmp_path / "mine.py", "1")
    assert own(tmp_path / "mine.py", "22") != first
    assert own(tmp_path / "mine.py", "1") == first
