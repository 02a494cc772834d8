"""Read run folders: summaries of one or several runs side by side, and the rows of their pairs."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from fullturn.errors import InputError, ReadError, one_line
from fullturn.evaluation.run import FORMAT, slug

_TOLD = "told_rotation_deg"  # in the description of a set


@dataclass(frozen=True)
class MethodResult:
    """What one method reached on one set, or on one group of a set."""

    summary: Mapping[str, Any]
    seed: int
    folder: Path
    cpu_seconds: float | None = None  # median; None: not timed
    told_rotation_deg: float | None = None  # None: it wasn't told how far clouds can be turned


@dataclass(frozen=True)
class SetResult:
    """What all methods reached on the same pairs."""

    name: str
    description: Mapping[str, Any]
    count: int
    methods: dict[str, MethodResult] = field(default_factory=dict)
    groups: dict[str, dict[str, MethodResult]] = field(default_factory=dict)


@dataclass(frozen=True)
class PairRows:
    """One method's answers to the pairs of a set."""

    rotation_error_deg: Float[np.ndarray, " related"]  # related pairs only; a failure is infinite
    success: Bool[np.ndarray, " n"]
    probability: Float[np.ndarray, " n"] | None  # None: the method states none


def read_runs(folders: Sequence[Path]) -> list[SetResult]:
    """The sets of all run folders in the order of their appearance, each with all its methods.

    Raises:
        ReadError: a folder without summary.json, or a damaged file.
        InputError: no folder, another format, one name for different pairs, a method twice.
    """
    if not folders:
        raise InputError("expected at least one run folder, got none; name one")
    sets: dict[str, SetResult] = {}
    for folder in folders:
        content, timing = _read_run(folder)
        for name, part in content["sets"].items():
            known = sets.setdefault(name, SetResult(name, part["description"], part["count"]))
            _check_same_pairs(known, part, folder)
            seconds = timing.get(name, {})
            for method, summary in part["methods"].items():
                if method in known.methods:
                    raise InputError(
                        f"expected each method once for {name}, got {method} from "
                        f"{known.methods[method].folder} and {folder}; leave one of them out"
                    )
                cpu = seconds.get(method, {}).get("cpu_seconds_median")
                told = _told_rotation_deg(content, part, method)
                known.methods[method] = MethodResult(summary, content["seed"], folder, cpu, told)
            for group, methods in part.get("groups", {}).items():
                for method, summary in methods.items():
                    times = seconds.get(method, {}).get("groups", {}).get(group, {})
                    cpu = times.get("cpu_seconds_median")
                    known.groups.setdefault(group, {})[method] = MethodResult(
                        summary, content["seed"], folder, cpu
                    )
    return list(sets.values())


def read_pairs(result: SetResult, method: str) -> PairRows | None:
    """The rows of one method, None where the run folder doesn't hold them.

    Raises:
        ReadError: the table is damaged.
    """
    path = result.methods[method].folder / "pairs" / f"{slug(result.name)}.csv"
    if not path.exists():
        return None
    try:
        with open(path, newline="", encoding="utf-8") as stream:
            rows = [row for row in csv.DictReader(stream) if row["method"] == method]
        related = [row for row in rows if row["related"] == "1"]
        errors = [np.inf if r["error"] else float(r["rotation_error_deg"]) for r in related]
        stated = [row["success_probability"] for row in rows]
        columns = PairRows(
            np.array(errors, dtype=np.float64),
            np.array([row["success"] == "1" for row in rows]),
            # A failed pair says nothing: it counts as probability 0.
            np.array([float(p or 0.0) for p in stated]) if any(stated) else None,
        )
    except (OSError, UnicodeDecodeError, csv.Error, KeyError, TypeError, ValueError) as error:
        raise ReadError(
            f"expected a table of pairs in {path}, could not read it ({one_line(error)}); "
            "run the evaluation again"
        ) from error
    if len(rows) != result.methods[method].summary["n"]:
        raise ReadError(
            f"expected {result.methods[method].summary['n']} pairs of {method} in {path}, found "
            f"{len(rows)}; run the evaluation again"
        )
    return columns


def _read_run(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The checked summary, and times by set and method; none where there is no timing.json."""
    path = folder / "summary.json"
    content = _read_json(path)
    if content.get("format") != FORMAT:
        raise InputError(
            f"expected format {FORMAT} in {path}, got {one_line(content.get('format'))}; run the "
            "evaluation again with this version of fullturn"
        )
    if not isinstance(content.get("seed"), int) or not _is_whole(content.get("sets")):
        raise ReadError(
            f"expected a seed and sets with description, count and methods in {path}, some are "
            "missing; run the evaluation again"
        )
    times = folder / "timing.json"
    timing: Any = _read_json(times).get("sets") if times.exists() else {}
    if not _is_nested(timing):
        raise ReadError(
            f"expected times by set and method in {times}, they are missing; run the evaluation "
            "again, or remove the file"
        )
    return content, timing


def _told_rotation_deg(
    content: Mapping[str, Any], part: Mapping[str, Any], method: str
) -> float | None:
    """The largest rotation of a set's pairs, if the method was one that takes it."""
    limit_deg = part["description"].get(_TOLD)
    described: Any = content.get("methods")
    for key in (method, "traits", "limits_rotation"):
        described = described.get(key) if isinstance(described, dict) else None
    return float(limit_deg) if described is True and isinstance(limit_deg, (int, float)) else None


def _is_nested(timing: Any) -> bool:
    return isinstance(timing, dict) and all(
        isinstance(part, dict) and all(isinstance(times, dict) for times in part.values())
        for part in timing.values()
    )


def _is_whole(sets: Any) -> bool:
    return isinstance(sets, dict) and all(map(_is_whole_set, sets.values()))


def _is_whole_set(part: Any) -> bool:
    if not isinstance(part, dict) or not isinstance(part.get("description"), dict):
        return False
    groups = part.get("groups", {})
    if "count" not in part or not isinstance(groups, dict):
        return False
    return all(
        isinstance(methods, dict)
        and all(isinstance(one, dict) and "n" in one for one in methods.values())
        for methods in (part.get("methods"), *groups.values())
    )


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ReadError(
            f"expected a run folder with the file {path.name} in it, there is none in "
            f"{path.parent}; name a folder that `fullturn evaluate` has written"
        ) from error
    except (OSError, ValueError) as error:
        raise ReadError(
            f"expected JSON in {path}, could not read it ({one_line(error)}); run the evaluation "
            "again"
        ) from error
    if not isinstance(content, dict):
        raise ReadError(
            f"expected a JSON object in {path}, got {type(content).__name__}; run the evaluation "
            "again"
        )
    return content


def _check_same_pairs(known: SetResult, part: Mapping[str, Any], folder: Path) -> None:
    """Methods stand beside one another only on the same pairs, whatever they were told of them."""
    first = {**_identity(known.description), "count of pairs": known.count}
    other = {**_identity(part["description"]), "count of pairs": part["count"]}
    differing = sorted(
        key for key in (first.keys() | other.keys()) - {_TOLD} if first.get(key) != other.get(key)
    )
    if differing:
        raise InputError(
            f"expected the same pairs for all methods of {known.name}, but {folder} differs from "
            f"the runs before it in: {', '.join(differing)}; evaluate the methods on one set, "
            "with the same shapes, count and seed"
        )


def _identity(description: Mapping[str, Any]) -> dict[str, Any]:
    """What tells sets apart: of a frozen file its arrays, whatever it is called."""
    match description:
        case {"frozen": {"sha256": arrays}}:
            return {**description, "frozen": arrays}
    return dict(description)
