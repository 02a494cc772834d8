"""Anybody's own method, by where its class stands: "file.py:Class" or "package.module:Class"."""

from __future__ import annotations

import ast
import hashlib
import inspect
import sys
from importlib import import_module, util
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from fullturn.errors import InputError, one_line

if TYPE_CHECKING:
    from fullturn.methods.base import Method

_folders: set[Path] = set()  # of the files that were run here: imports find what lies in them


def own_method(place: str) -> type[Method]:
    """The class at "file.py:Class" or "package.module:Class".

    A file is run once, and again only when it has changed; it can import what lies beside it.

    Raises:
        InputError: no such file, module or class, an error while it is imported, or a class that
            is not a finished `Method`; a module beside the file that is called as one beside
            another file that was run before.
    """
    home, _, name = place.rpartition(":")
    if not home or not name.isidentifier():
        raise InputError(
            f"method: expected file.py:Class or package.module:Class, got {place!r:.200}"
        )
    module = _from_file(Path(home)) if home.endswith(".py") else _from_name(home)
    found = getattr(module, name, None)
    if found is None:
        raise InputError(f"method: expected a class {name} in {home}, found none of that name")
    return _checked(found, place)


def _from_file(path: Path) -> ModuleType:
    if not path.is_file():
        raise InputError(f"method: expected a Python file {path}, there is none")
    path = path.resolve()
    state = path.stat()
    key = f"{path}\n{state.st_mtime_ns}\n{state.st_size}"
    name = f"_fullturn_own_{path.stem}_{hashlib.sha256(key.encode()).hexdigest()[:16]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise InputError(f"method: expected a Python file, got {path}")
    _check_neighbors(path)
    _folders.add(path.parent)
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))  # last, so that it hides nothing that is installed
    module = util.module_from_spec(spec)
    # Dataclasses look for the module that they stand in while it is still being run.
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise _failed(str(path), error) from error
    return module


def _check_neighbors(path: Path) -> None:
    """A name is one module in a process: no file may get what lies beside another one."""
    from fullturn.methods.fingerprint import imported_names

    waiting, seen = [path], set[str]()
    while waiting:
        try:
            tree = ast.parse(waiting.pop().read_bytes())
        except (SyntaxError, ValueError):
            continue  # running it says more
        for name in {name.partition(".")[0] for name in imported_names(tree, [])} - seen:
            seen.add(name)
            beside = PathFinder.find_spec(name, [str(path.parent)])
            if beside is None or beside.origin is None:
                continue
            found = util.find_spec(name)
            place = Path(str(found.origin if found else None))
            others = {folder / part for folder in _folders for part in ("", name)}
            if str(place) != beside.origin and place.parent in others:
                raise InputError(
                    f"method: {path} imports {name} from beside it, but that is {place} of another "
                    "method in this process; give one of the two another name, or use the methods "
                    "in processes of their own"
                )
            waiting.append(Path(beside.origin))


def _from_name(name: str) -> ModuleType:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and f"{name}.".startswith(f"{error.name}."):
            raise InputError(
                f"method: expected an installed module {name}, there is none; for a file, write "
                "file.py:Class"
            ) from error
        raise _failed(name, error) from error
    except (Exception, SystemExit) as error:
        raise _failed(name, error) from error


def _failed(home: str, error: BaseException) -> InputError:
    told = one_line(error)[:300]
    return InputError(f"method: {home} cannot be imported: {type(error).__name__}: {told}")


def _checked(found: object, place: str) -> type[Method]:
    from fullturn.methods.base import Method

    if not (isinstance(found, type) and issubclass(found, Method)):
        raise InputError(
            f"method: expected {place} to be a subclass of fullturn.methods.base.Method, got "
            f"{'another class' if isinstance(found, type) else f'a {type(found).__name__}'}"
        )
    if inspect.isabstract(found):
        raise InputError(f"method: expected {place} to define estimate(), it does not")
    lacking = [
        word
        for word in ("name", "summary", "reference")
        if not isinstance(getattr(found, word, None), str)
    ]
    if lacking:
        raise InputError(f"method: expected {place} to have the strings {', '.join(lacking)}")
    return found
