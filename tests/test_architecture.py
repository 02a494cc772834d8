"""The rules of docs/architecture.md that a program can check."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "fullturn"
FILES = sorted(SOURCE.rglob("*.py"))

# A room imports itself, rooms to its left and the foundation.
ORDER = ["geometry", "features", "nn", "matching", "pose", "methods"]
ORDER += ["io", "data", "viz", "api", "training", "evaluation"]
ORDER += ["locating", "fusion", "cluster", "cli"]
FOUNDATION = {"__init__", "errors", "result"}
# The front door is more than one file.
PART_OF = dict.fromkeys(["batch", "normalize", "progress", "threads", "workers"], "api")
# Rooms of which more is asked: all that they may import beside themselves and the foundation.
ONLY = {"io": {"geometry"}, "viz": {"geometry", "io"}, "data": {"geometry", "io"}}

# Where a tensor is moved to the CPU on purpose, and why.
MAY_MOVE = {"io/load.py": "arrays come out of load_cloud, whatever device a tensor was on"}

GLOBAL_SEEDS = {"numpy.random.seed", "np.random.seed", "torch.manual_seed", "random.seed"}
GLOBAL_SEEDS |= {"torch.cuda.manual_seed", "torch.cuda.manual_seed_all", "torch.seed"}
GLOBAL_DRAWS = {"rand", "randn", "randint", "random", "choice", "normal", "uniform", "permutation"}


def room_of(name: str) -> str:
    return PART_OF.get(name, name)


def imported_rooms(node: ast.AST) -> Iterator[str]:
    """Rooms imported anywhere below a node, leaving out `if TYPE_CHECKING:`."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and ast.unparse(child.test).endswith("TYPE_CHECKING"):
            for other in child.orelse:
                yield from imported_rooms(other)
            continue
        names: list[str] = []
        if isinstance(child, ast.Import):
            names = [alias.name for alias in child.names]
        elif isinstance(child, ast.ImportFrom):
            if child.level:
                raise AssertionError(f"relative import in line {child.lineno}")
            names = [f"{child.module}.{alias.name}" for alias in child.names]
        for name in names:
            parts = name.split(".")
            if parts[0] == "fullturn" and len(parts) > 1:
                yield room_of(parts[1])
        yield from imported_rooms(child)


def calls(tree: ast.AST) -> Iterator[tuple[str, ast.Call]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func), node


def parse(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"), str(file))


def named(files: list[Path]) -> list[object]:
    return [pytest.param(file, id=file.relative_to(SOURCE).as_posix()) for file in files]


def allowed_for(room: str) -> set[str]:
    return {room} | ONLY.get(room, set(ORDER[: ORDER.index(room)])) | FOUNDATION


@pytest.mark.parametrize("file", named(FILES))
def test_imports_go_in_one_direction(file: Path) -> None:
    room = room_of(file.relative_to(SOURCE).parts[0].removesuffix(".py"))
    found = set(imported_rooms(parse(file)))
    if room in FOUNDATION:
        assert found <= FOUNDATION
        return
    assert room in ORDER, f"a room without a place in the order: {room}"
    known = {other for other in found if other in ORDER or other in FOUNDATION}
    # What is left are names of the package itself, such as __version__ or register.
    assert all(name in {"__version__", "Registration"} for name in found - known), found - known
    assert known <= allowed_for(room), f"{room} must not import {sorted(known - allowed_for(room))}"


@pytest.mark.parametrize("file", named(FILES))
def test_users_never_meet_an_assert(file: Path) -> None:
    lines = [node.lineno for node in ast.walk(parse(file)) if isinstance(node, ast.Assert)]
    assert lines == []


@pytest.mark.parametrize("file", named(FILES))
def test_no_global_randomness(file: Path) -> None:
    for name, call in calls(parse(file)):
        head, _, last = name.rpartition(".")
        assert name not in GLOBAL_SEEDS, f"line {call.lineno}: {name}"
        legacy = head in {"np.random", "numpy.random", "random"} and last in GLOBAL_DRAWS
        assert not legacy, f"line {call.lineno}: {name} draws from the global generator"


@pytest.mark.parametrize("file", named(FILES))
def test_no_device_is_chosen(file: Path) -> None:
    if file.relative_to(SOURCE).as_posix() in MAY_MOVE:
        return
    for name, call in calls(parse(file)):
        last = name.rpartition(".")[2]
        words = [*call.args, *(keyword.value for keyword in call.keywords)]
        fixed = {word.value for word in words if isinstance(word, ast.Constant)}
        chosen = last in {"cuda", "cpu"} and "." in name and not fixed
        chosen |= last == "to" and any(str(word).startswith(("cuda", "cpu")) for word in fixed)
        assert not chosen, f"line {call.lineno}: {name}(); follow the input's device"


def test_the_exceptions_are_still_needed() -> None:
    for path in MAY_MOVE:
        text = (SOURCE / path).read_text(encoding="utf-8")
        assert any(move in text for move in ('"cpu"', ".cpu()", '"cuda"', ".cuda()")), path


def test_the_order_is_the_documented_one() -> None:
    text = (SOURCE.parents[1] / "docs" / "architecture.md").read_text(encoding="utf-8")
    line = next(line for line in text.splitlines() if "geometry → features" in line)
    documented = line.strip().replace("{", "").replace("}", "").replace(", ", " → ").split(" → ")
    assert set(documented) == set(ORDER)
    siblings = {"data", "evaluation", "viz", "io"}
    assert [room for room in documented if room not in siblings] == [
        room for room in ORDER if room not in siblings
    ]


@pytest.mark.parametrize("module", ["fullturn", "fullturn.io", "fullturn.viz.report"])
def test_torch_is_not_imported(module: str) -> None:
    code = f"import sys, {module}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
