"""What a method's answers depend on besides the pair: its code, its weights, its packages."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from importlib import metadata
from importlib.machinery import PathFinder
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
    same package, of fullturn and of what isn't installed, such as a file beside one's own, that is
    imported, but for type checking, with those of fullturn's weights that one of them names. What a
    package loads in other ways isn't seen.
    """
    files, packages = _closure(method, roots)
    files |= set(method.files)
    files |= {file for name in _TELLING for file, _ in _modules(name)[-1:]}
    packages |= set(method.needs)  # imported by name, when the method is made
    # By name and content: where the files lie, and in which order a set holds them, is nothing.
    lines = sorted(f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()}" for path in files)
    versions = {owner: metadata.version(owner) for owner in sorted(_owners(packages))}
    content = (method.__qualname__, *lines, repr(versions))
    return hashlib.sha256("\n".join(content).encode()).hexdigest(), versions


def _closure(method: type[Method], roots: Sequence[str]) -> tuple[set[Path], set[str]]:
    """The files that the method's module and the roots lead to, and the packages that they use."""
    module = sys.modules[method.__module__]
    home = method.__module__.partition(".")[0]
    weights = set(Path(fullturn.__file__).parent.glob("weights/*.safetensors"))
    files: set[Path] = set()
    packages: set[str] = set()
    start = (Path(str(module.__file__)), module.__package__ or "")
    waiting = [start, *(one for root in roots for one in _modules(root)[-1:])]
    while waiting:
        path, package = waiting.pop()
        if path in files:
            continue
        files.add(path)
        if path.suffix != ".py":  # compiled
            continue
        source = path.read_bytes()  # as it is: a file may say how it is encoded
        files |= {one for one in weights if one.name.encode() in source}
        for name in imported_names(ast.parse(source), package.split(".") if package else []):
            top = name.partition(".")[0]
            if top in sys.stdlib_module_names:
                continue
            found = _modules(name)
            if top == _PACKAGE:
                waiting += found[-1:]  # the packages that it stands in do nothing
            elif top == home or (found and not _is_installed_file(found[-1][0])):
                waiting += found
            else:
                packages.add(top)
    return files, packages


def _is_installed_file(path: Path) -> bool:
    return not {"site-packages", "dist-packages"}.isdisjoint(path.parts)


def imported_names(tree: ast.AST, package: Sequence[str]) -> Iterator[str]:
    """Every name that may be a module: ``from a import b`` gives a and a.b.

    `package` is where relative imports start.
    """
    if isinstance(tree, ast.If) and getattr(tree.test, "id", None) == "TYPE_CHECKING":
        return
    if isinstance(tree, ast.Import):
        yield from (alias.name for alias in tree.names)
    elif isinstance(tree, ast.ImportFrom):
        if tree.level > len(package):
            return  # can't be imported
        start = package[: len(package) + 1 - tree.level] if tree.level else []
        name = ".".join([*start, *filter(None, [tree.module])])
        yield name
        yield from (f"{name}.{alias.name}" for alias in tree.names)
    for node in ast.iter_child_nodes(tree):
        yield from imported_names(node, package)


def _modules(name: str) -> list[tuple[Path, str]]:
    """The files that importing a name runs, outermost first, each with the package it stands in.

    The last part of the name may be something in a module. Nothing is imported.
    """
    found: list[tuple[Path, str]] = []
    first, *parts = name.split(".")
    try:
        spec = importlib.util.find_spec(first)
    except ValueError:  # a module without a specification, such as a script
        return []
    whole = first
    while spec is not None:
        if spec.has_location and (path := Path(str(spec.origin))).is_file():
            found.append((path, spec.parent or ""))
        if not parts or spec.submodule_search_locations is None:
            break
        whole = f"{whole}.{parts.pop(0)}"
        spec = PathFinder.find_spec(whole, spec.submodule_search_locations)
    return found


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
