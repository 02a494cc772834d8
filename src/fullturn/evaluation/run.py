"""Run: methods × sets of pairs → predictions from the cache or fresh, scores, a run folder."""

from __future__ import annotations

import csv
import io
import json
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

import fullturn
from fullturn.data.pair import Pair
from fullturn.data.pair_set import PairSet
from fullturn.data.provenance import working_tree_commit
from fullturn.errors import FullturnError, InputError
from fullturn.evaluation.cache import PredictionCache
from fullturn.evaluation.predict import Prediction, Predictor, pair_hash
from fullturn.evaluation.score import Score, ScoredPair, summarize
from fullturn.io.atomic import make_folder, write_atomic
from fullturn.methods.base import Method
from fullturn.methods.check import make_method
from fullturn.methods.fingerprint import fingerprint
from fullturn.methods.registry import get
from fullturn.workers import Crew

FORMAT = 1


def evaluate(
    sets: Sequence[PairSet],
    methods: Sequence[str],
    *,
    out: Path,
    cache: Path,
    seed: int = 0,
    workers: int = 1,
    advance: Callable[[int], None] = lambda count: None,
    note: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Write the run folder `out` and return its summary. See docs/architecture.md.

    `advance` is told of finished predictions, cached ones included, `note` of what a user should
    know. An interrupted run keeps its predictions in `cache`.

    Raises:
        InputError: no set, no method, two of one name, an unknown method.
        DependencyError: a method's package is missing.
        WriteError: a folder cannot be written.
    """
    names = _checked_names(sets, methods)
    # Taken once: a run has one code of each method, whatever is edited meanwhile.
    prints = {name: fingerprint(get(method)) for name, method in names.items()}
    make_folder(out / "pairs")
    summary: dict[str, Any] = {
        "format": FORMAT,
        "fullturn": fullturn.__version__,
        "commit": working_tree_commit(),
        "seed": seed,
        "methods": {n: _described(get(method), prints[n][1]) for n, method in names.items()},
        "sets": {},
    }
    commit = summary["commit"]
    timing: dict[str, Any] = {"commit": commit, "machine": machine(), "sets": {}}
    files: dict[str, str] = {}
    with Crew(Predictor(seed), workers=workers) as crew:
        codes = {name: code for name, (code, _) in prints.items()}
        oracle = _Oracle(names, codes, seed, cache, crew, advance, note)
        for pairs in sets:
            answers, rows = _answers_and_rows(pairs, oracle)
            summary["sets"][pairs.name] = {
                "description": pairs.description,
                "count": len(pairs),
                **_summaries(rows, seed=seed),
            }
            timing["sets"][pairs.name] = {
                name: _times_by_group(found, [row.group for row in rows[name]])
                for name, found in answers.items()
            }
            files[f"pairs/{slug(pairs.name)}.csv"] = _csv(rows)
    files["timing.json"] = json.dumps(timing, indent=1) + "\n"
    files["summary.json"] = json.dumps(summary, indent=1) + "\n"
    # All at the end: until then, the folder holds the whole of the run before.
    for name, content in files.items():
        write_atomic(out / name, content)
    return summary


def slug(name: str) -> str:
    """A name as a file name.

    >>> slug("modelnet40/clean/180")
    'modelnet40-clean-180'
    """
    return "".join(c if c.isalnum() or c in "-_." else "-" for c in name)


def _described(method: type[Method], versions: dict[str, str]) -> dict[str, Any]:
    """What the summary says of a method, with the versions of its packages."""
    return {
        "summary": method.summary,
        "reference": method.reference,
        "settings": dict(method.settings()),
        "traits": asdict(method.traits),
        "versions": versions,
    }


def _checked_names(sets: Sequence[PairSet], methods: Sequence[str]) -> dict[str, str]:
    """What the tables call each method → what it was asked for as."""
    if not sets or not methods:
        raise InputError(
            f"expected at least one set of pairs and one method, got {len(sets)} and {len(methods)}"
        )
    names: dict[str, str] = {}
    for method in methods:
        found = make_method(method)  # says now, and not once per pair, that a package is missing
        if found.name in names:
            raise InputError(f"expected different methods, got {found.name} twice; drop one")
        names[found.name] = method
    if len({slug(pairs.name) for pairs in sets}) < len(sets):
        raise InputError(
            f"expected sets with different names, got {', '.join(p.name for p in sets)}; drop one"
        )
    return names


def _answers_and_rows(
    pairs: PairSet, oracle: _Oracle
) -> tuple[dict[str, list[Prediction]], dict[str, list[Score]]]:
    """Every method's answers to a set, and their scores."""
    made = list(pairs)
    answers = oracle.answers(pairs.name, made)
    scored = [ScoredPair(pair, index=i, group=pairs.group(i)) for i, pair in enumerate(made)]
    return answers, {
        name: [pair.score(one) for pair, one in zip(scored, found, strict=True)]
        for name, found in answers.items()
    }


@dataclass(frozen=True)
class _Oracle:
    """Knows every method's answer to every pair: from the cache, or else from the crew."""

    methods: Mapping[str, str]
    codes: Mapping[str, str]  # of each method, the hash of its code
    seed: int
    folder: Path
    crew: Crew
    advance: Callable[[int], None]
    note: Callable[[str], None]

    def answers(self, set_name: str, pairs: Sequence[Pair]) -> dict[str, list[Prediction]]:
        """By method, one prediction a pair."""
        hashes = [pair_hash(pair) for pair in pairs]
        caches = {name: self._cache(set_name, name) for name in self.methods}
        tasks: list[tuple[str, int]] = []
        for name, cache in caches.items():
            lacking = {h: i for i, h in enumerate(hashes) if h not in cache.found}
            tasks += [(name, index) for index in lacking.values()]
            self.advance(len(pairs) - len(lacking))

        def done(number: int, result: Prediction | FullturnError) -> None:
            name, index = tasks[number]
            if isinstance(result, FullturnError):  # the process died
                result = Prediction(np.eye(4), error=str(result))
            if result.error is not None:
                # It may be due to this run alone, such as too little memory: tried again next time.
                caches[name].found[hashes[index]] = result
            else:
                caches[name].add(hashes[index], result)
            self.advance(1)

        if tasks:
            self.crew.run(((self.methods[name], pairs[index]) for name, index in tasks), done)
        return {name: [cache.found[h] for h in hashes] for name, cache in caches.items()}

    def _cache(self, set_name: str, name: str) -> PredictionCache:
        stem = f"{slug(name)}-{self.codes[name][:16]}-{self.seed}"
        cache = PredictionCache(self.folder / slug(set_name) / f"{stem}.jsonl")
        if cache.damaged:
            self.note(
                f"{cache.damaged} damaged lines of {cache.path} were dropped; their pairs are "
                "predicted again"
            )
        return cache


def _summaries(rows: Mapping[str, Sequence[Score]], *, seed: int) -> dict[str, Any]:
    """Summaries by method, and by group and method where the set has groups."""
    part: dict[str, Any] = {"methods": {n: summarize(r, seed=seed) for n, r in rows.items()}}
    groups = sorted({row.group for scores in rows.values() for row in scores} - {""})
    if groups:
        part["groups"] = {
            group: {
                name: summarize([row for row in scores if row.group == group], seed=seed)
                for name, scores in rows.items()
            }
            for group in groups
        }
    return part


def _times_by_group(answers: Sequence[Prediction], groups: Sequence[str]) -> dict[str, Any]:
    times: dict[str, Any] = _times(answers)
    if named := sorted(set(groups) - {""}):
        times["groups"] = {
            name: _times([a for a, group in zip(answers, groups, strict=True) if group == name])
            for name in named
        }
    return times


def _times(answers: Sequence[Prediction]) -> dict[str, Any]:
    cpu = np.array([answer.cpu_seconds for answer in answers])
    wall = np.array([answer.wall_seconds for answer in answers])
    return {
        "cpu_seconds_mean": float(cpu.mean()),
        "cpu_seconds_median": float(np.median(cpu)),
        "cpu_seconds_p95": float(np.quantile(cpu, 0.95)),
        "wall_seconds_median": float(np.median(wall)),
    }


def _csv(rows: Mapping[str, Sequence[Score]]) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["method", *(field.name for field in fields(Score))])
    for name, scores in rows.items():
        writer.writerows([name, *map(_cell, asdict(score).values())] for score in scores)
    return stream.getvalue()


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def machine() -> dict[str, Any]:
    """What times were taken on."""
    processor = platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor = next(x.split(":", 1)[1].strip() for x in lines if x.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return {"python": platform.python_version(), "processor": processor, "threads": 1}
