"""One's own methods by file or module, and what is said where they can't be had."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import fullturn
from fullturn.cli.main import build_app
from fullturn.errors import FullturnError, InputError
from fullturn.methods.registry import get

GOOD = """
from __future__ import annotations
from dataclasses import dataclass, field
import torch
from fullturn.methods.base import Estimate, Method

@dataclass
class Settings:
    turns: list[int] = field(default_factory=list)

class Base(Method):
    name, summary, reference = "base", "one", "none"

class Identity(Base):
    name = "identity"
    config = Settings([1, 2])
    def estimate(self, source, target, *, rng):
        return Estimate(torch.eye(4)[None])

class Other: ...
class Nameless(Method):
    def estimate(self, source, target, *, rng): ...
value = 3
"""
CLOUD = np.random.default_rng(0).normal(size=(60, 3))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(GOOD)
    return path


def test_a_file_gives_its_class(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    method = get(f"{file}:Identity")
    assert method.name == "identity"
    assert method.settings() == {"turns": [1, 2]}
    assert get(f"{file}:Identity") is method
    result = fullturn.register(CLOUD, CLOUD + 4, method=f"{file}:Identity")
    np.testing.assert_allclose(result.T_target_source[:3, 3], 4.0)
    assert result.method == "identity"
    monkeypatch.chdir(file.parent)
    assert get("mine.py:Identity") is method


def test_a_changed_file_is_run_again(file: Path) -> None:
    before = get(f"{file}:Identity")
    file.write_text(GOOD.replace('"identity"', '"changed"'))
    os.utime(file, ns=(1, 1))
    assert (before.name, get(f"{file}:Identity").name) == ("identity", "changed")


def test_a_module_gives_its_class(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(file.parent))
    assert get("mine:Identity").name == "identity"
    assert get("fullturn.methods.consensus:Consensus") is get("auto")
    del sys.modules["mine"]


def test_a_file_imports_what_lies_beside_it(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [*sys.path])
    (file.parent / "beside_mine.py").write_text("value = 3\n")
    file.write_text("import beside_mine\n" + GOOD.partition("\n")[2].partition("\n")[2])
    assert get(f"{file}:Identity").name == "identity"


def test_no_file_gets_what_lies_beside_another_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", [*sys.path])
    texts = {
        "one/mine.py": f"import own_kit{GOOD.replace('from __future__ import annotations', '')}",
        "one/own_kit/__init__.py": "",
        "two/mine.py": f"import own_helper{GOOD.replace('from __future__ import annotations', '')}",
        "two/own_helper.py": "def late():\n    import own_kit.part\n",
        "two/own_kit.py": "",
        "three/mine.py": GOOD,
        "three/own_kit.py": "",
    }
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    get(f"{tmp_path}/one/mine.py:Identity")
    message = "two/mine.py imports own_kit from beside it, but that is .*one/own_kit/__init__.py of"
    with pytest.raises(InputError, match=message):
        get(f"{tmp_path}/two/mine.py:Identity")
    get(f"{tmp_path}/three/mine.py:Identity")  # imports nothing of that name
    del sys.modules["own_kit"]


def test_workers_find_it_too(file: Path) -> None:
    results = fullturn.register_many([(CLOUD, CLOUD)] * 2, method=f"{file}:Identity", workers=2)
    assert [type(r).__name__ for r in results] == ["Registration"] * 2


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("mine.py", "expected file.py:Class or package.module:Class, got 'mine.py'"),
        ("mine.py:", "expected file.py:Class"),
        (":Identity", "expected file.py:Class"),
        ("mine.py:not a name", "expected file.py:Class"),
        ("missing.py:Identity", "expected a Python file missing.py, there is none"),
        ("mine.py:Missing", "expected a class Missing in mine.py, found none"),
        ("mine.py:Other", "to be a subclass of fullturn.methods.base.Method, got another class"),
        ("mine.py:value", "got a int"),
        ("mine.py:Base", r"to define estimate\(\), it does not"),
        ("mine.py:Nameless", "to have the strings name, summary, reference"),
        ("broken.py:Identity", "broken.py cannot be imported: ZeroDivisionError: division by zero"),
        ("typo.py:Identity", "typo.py cannot be imported: SyntaxError"),
        ("leaves.py:Identity", "leaves.py cannot be imported: SystemExit: 3"),
        ("needs.py:Identity", "cannot be imported: ModuleNotFoundError: No module named 'nowhere'"),
        ("nowhere.at.all:Identity", "expected an installed module nowhere.at.all, there is none"),
        ("json:Identity", "expected a class Identity in json, found none"),
        ("..:Identity", ".. cannot be imported: TypeError"),
    ],
)
def test_what_cannot_be_had_is_named(
    place: str, message: str, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(file.parent)
    Path("broken.py").write_text("1 / 0\n")
    Path("typo.py").write_text("class Identity\n")
    Path("leaves.py").write_text("raise SystemExit(3)\n")
    Path("needs.py").write_text("import nowhere\n")
    loaded = set(sys.modules)
    with pytest.raises(InputError, match=rf"^method: .*{message}") as caught:
        get(place)
    assert "\n" not in str(caught.value)
    assert not any("broken" in name for name in set(sys.modules) - loaded)


FAULTY = """
import numpy as np
from fullturn.methods.base import Method

class Base(Method):
    name, summary, reference = "faulty", "one", "none"
    def estimate(self, source, target, *, rng):
        return self.answer(source)

class Raises(Base):
    def answer(self, source):
        raise KeyError("a\\nfault")

class Calls(Base):
    def answer(self, source):
        return np.linalg.inv(np.zeros((2, 2)))  # raises in a file of NumPy

class Opens(Base):
    def answer(self, source):
        return open("no_such_weights")

class Leaves(Base):
    def answer(self, source):
        raise SystemExit(3)

class NotMade(Base):
    def __init__(self):
        raise FileNotFoundError("no weights")

class Deaf(Base):
    def estimate(self, source): ...
"""


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Raises", r"method faulty, estimate\(\): KeyError: 'a\\nfault' \(faulty.py, line 12\)"),
        ("Calls", r"method faulty, estimate\(\): LinAlgError: .* \(faulty.py, line 16\)"),
        ("Opens", r"method faulty, estimate\(\): FileNotFoundError: .* \(faulty.py, line 20\)"),
        ("Leaves", r"method faulty, estimate\(\): SystemExit: 3 \(faulty.py, line 24\)"),
        ("NotMade", r"method faulty: FileNotFoundError: no weights \(faulty.py, line 28\)"),
        ("Deaf", r"method faulty, estimate\(\): TypeError: .*\(check.py, line \d+\)"),
    ],
)
def test_what_it_raises_is_one_error_that_names_it(name: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "faulty.py"
    path.write_text(FAULTY)
    method = f"{path}:{name}"
    with pytest.raises(FullturnError, match=f"^{message}$") as caught:
        fullturn.register(CLOUD, CLOUD, method=method)
    assert type(caught.value.__cause__).__name__ in message
    np.save(tmp_path / "a.npy", CLOUD)
    files = [str(tmp_path / "a.npy")] * 2
    done = CliRunner().invoke(build_app(), ["register", *files, "--method", method])
    assert (done.exit_code, done.stdout) == (1, "")
    assert done.stderr == f"fullturn: error: {caught.value}\n"
