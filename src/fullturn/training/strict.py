"""A table of plain values as a frozen dataclass, and back: unknown keys and wrong types are told.

All of them at once, each with its full name.
"""

from __future__ import annotations

import dataclasses
import json
import types
from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from fullturn.errors import InputError

_Config = TypeVar("_Config")


class _Problem(Exception):
    pass


def from_table(kind: type[_Config], table: Mapping[str, Any], *, name: str) -> _Config:
    """A dataclass from a table that may leave out what has a default.

    Raises:
        InputError: unknown or missing keys, values of a wrong type or out of bounds; all of them.
    """
    problems: list[str] = []
    made = _dataclass(kind, table, "", problems)
    if problems:
        raise InputError(f"{name}: " + " | ".join(problems))
    return made


def to_table(config: Any) -> dict[str, Any]:
    """The plain values of a dataclass, without what is None; the inverse of `from_table`."""
    table: dict[str, Any] = {}
    for one in dataclasses.fields(config):
        value = getattr(config, one.name)
        if value is not None:
            table[one.name] = _plain(value)
    return table


def to_toml(table: Mapping[str, Any]) -> str:
    """The table as TOML: values first, tables of the first level as sections."""
    sections = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    lines = [f"{key} = {_inline(value)}" for key, value in table.items() if key not in sections]
    for key, section in sections.items():
        lines += [
            "",
            f"[{key}]",
            *(f"{name} = {_inline(value)}" for name, value in section.items()),
        ]
    return "\n".join(lines) + "\n"


def _dataclass(kind: type[Any], table: Mapping[str, Any], path: str, problems: list[str]) -> Any:
    hints = get_type_hints(kind)
    known = {one.name: one for one in dataclasses.fields(kind)}
    for key in table:
        if key not in known:
            near = get_close_matches(key, known, n=1)
            hint = f"did you mean {path}{near[0]}?" if near else f"expected {', '.join(known)}"
            problems.append(f"{path}{key}: unknown key; {hint}")
    missing = [
        key
        for key, one in known.items()
        if key not in table
        and one.default is dataclasses.MISSING
        and one.default_factory is dataclasses.MISSING
    ]
    problems += [f"{path}{key}: missing" for key in missing]
    values = {}
    for key in known.keys() & table.keys():
        try:
            values[key] = _value(hints[key], table[key], f"{path}{key}", problems)
        except _Problem as problem:
            problems.append(f"{path}{key}: {problem}")
    if missing:
        return None
    # What is wrong stands in the list already; the rest is still worth checking.
    values = {key: value for key, value in values.items() if value is not None}
    try:
        return kind(**values)
    except InputError as error:
        problems.append(f"[{path.removesuffix('.')}] {error}" if path else str(error))
        return None


def _value(kind: Any, value: Any, path: str, problems: list[str]) -> Any:
    origin, inner = get_origin(kind), get_args(kind)
    if dataclasses.is_dataclass(kind):
        if not isinstance(value, Mapping):
            raise _Problem(f"expected a table, got {value!r}")
        return _dataclass(kind, value, f"{path}.", problems)  # type: ignore[arg-type]
    if origin in (Union, types.UnionType):
        return _value(next(i for i in inner if i is not type(None)), value, path, problems)
    if origin is Literal:
        if value not in inner:
            raise _Problem(f"expected one of {', '.join(map(str, inner))}; got {value!r}")
        return value
    if origin is tuple:
        if not isinstance(value, list | tuple):
            raise _Problem(f"expected a list, got {value!r}")
        kinds = [inner[0]] * len(value) if inner[-1] is ... else list(inner)
        if len(value) != len(kinds):
            raise _Problem(f"expected {len(kinds)} values, got {len(value)}")
        return tuple(
            _value(one, item, f"{path}[{number}]", problems)
            for number, (one, item) in enumerate(zip(kinds, value, strict=True))
        )
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if type(value) is not kind:
        raise _Problem(f"expected {_NAMES.get(kind, kind.__name__)}, got {value!r}")
    return value


_NAMES = {int: "a whole number", float: "a number", bool: "true or false", str: "a text"}


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return to_table(value)
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def _inline(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_inline(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return f"[{', '.join(map(_inline, value))}]"
    # A JSON text, number or truth value is a TOML one, too, but for one character.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
