"""What a method's answers depend on besides the pair: its code, its weights, its packages."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from importlib import metadata
from pathlib import Path

import fullturn
from fullturn.methods.base import Method

_PACKAGE = "fullturn"


ESTIMATE = ("fullturn.normalize",)  # between a pair and the poses that a method finds
_TELLING = ("fullturn.evaluation.predict", "fullturn.methods.check")  # not what they import
REGISTER = ("fullturn.api",)  # … and all that `register` says of them


def fingerprint(
    method: type[Method], *, roots: Sequence[str] = ESTIMATE
) -> tuple[str, dict[str, str]]:
    """A hash of a method's code and versions, and the versions of the packages that it uses.

    The code is the module of the class, the modules `roots` and, from there on, every module of the
    same package and of fullturn that is imported, but for type checking, with those of fullturn's
    weights that one of them names. What a package loads in other ways isn't seen.
    """
    files, packages = _closure(method, roots)
    files |= set(method.files)
    files |= {file for name in _TELLING for file in _module_file(name)}
    packages |= set(method.needs)  # imported by name, when the method is made
    # By name and content: where the files lie, and in which order a set holds them, is nothing.
    lines = sorted(f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()}" for path in files)
    versions = {owner: metadata.version(owner) for owner in sorted(_owners(packages))}
    content = (method.__qualname__, *lines, repr(versions))
    return hashlib.sha256("\n".join(content).encode()).hexdigest(), versions


def _closure(method: type[Method], roots: Sequence[str]) -> tuple[set[Path], set[str]]:
    """The files that the method's module and the roots lead to, and the packages that they use."""
    module = sys.modules[method.__module__]
    ours = {_PACKAGE, method.__module__.partition(".")[0]}
    weights = set(Path(fullturn.__file__).parent.glob("weights/*.safetensors"))
    files: set[Path] = set()
    packages: set[str] = set()
    waiting = [Path(str(module.__file__)), *(file for root in roots for file in _module_file(root))]
    while waiting:
        path = waiting.pop()
        if path in files:
            continue
        files.add(path)
        source = path.read_text(encoding="utf-8")
        files |= {one for one in weights if one.name in source}
        for name in _imports(ast.parse(source), _package_of(path)):
            top = name.partition(".")[0]
            if top in ours:
                waiting += _module_file(name)
            elif top not in sys.stdlib_module_names:
                packages.add(top)
    return files, packages


def _package_of(path: Path) -> list[str]:
    """The names from the outermost package down to that of a module."""
    names: list[str] = []
    for folder in path.parents:
        if not (folder / "__init__.py").exists():
            break
        names.insert(0, folder.name)
    return names


def _imports(tree: ast.AST, package: Sequence[str]) -> Iterator[str]:
    """Every name that may be a module: ``from a import b`` gives a and a.b.

    `package` is where relative imports start.
    """
    if isinstance(tree, ast.If) and getattr(tree.test, "id", None) == "TYPE_CHECKING":
        return
    if isinstance(tree, ast.Import):
        yield from (alias.name for alias in tree.names)
    elif isinstance(tree, ast.ImportFrom):
        start = package[: len(package) + 1 - tree.level] if tree.level else []
        name = ".".join([*start, *filter(None, [tree.module])])
        yield name
        yield from (f"{name}.{alias.name}" for alias in tree.names)
    for node in ast.iter_child_nodes(tree):
        yield from _imports(node, package)


def _module_file(name: str) -> list[Path]:
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):
        return []  # not a module, but something in one
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return []
    return [Path(spec.origin)]


def _owners(packages: set[str]) -> set[str]:
    """The installed distributions that packages come from."""
    known = _distributions()
    # A package that is one binary file isn't listed, but most are called as what they hold.
    owners = {owner for package in packages for owner in known.get(package, [package])}
    return {owner for owner in owners if _is_installed(owner)}


def _is_installed(distribution: str) -> bool:
    try:
        metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return False
    return True


@cache
def _distributions() -> dict[str, list[str]]:
    return dict(metadata.packages_distributions())
