"""What the benchmarks share: run a method on pairs in one-thread processes, score, write down."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fullturn.data.pair import Pair
from fullturn.errors import FullturnError
from fullturn.evaluation import metrics
from fullturn.methods import registry

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Answer:
    """What a benchmark keeps of one registration."""

    T_target_source: np.ndarray  # (4, 4)
    success_probability: float | None = None  # None: the method gives none
    alternatives: tuple[np.ndarray, ...] = ()  # (4, 4) each
    seconds: dict[str, float] = field(default_factory=dict)  # per stage, by its own clock
    error: str | None = None  # the method refused; its pose is the identity


Registrar = Callable[[Pair, int], Answer]


def register_with(method: str, pair: Pair, seed: int) -> Answer:
    """The answer of a registered fullturn method."""
    import torch

    import fullturn

    torch.set_num_threads(1)
    try:
        result = fullturn.register(pair.source, pair.target, method=method, seed=seed)
    except FullturnError as error:
        return Answer(np.eye(4), 0.0, error=f"{type(error).__name__}: {error}")
    return Answer(
        result.T_target_source,
        result.success_probability,
        tuple(other.T_target_source for other in result.alternatives),
        dict(result.seconds),
    )


def fullturn_registrar(method: str) -> Registrar:
    """`register_with` for one method; it can be sent to another process.

    An unknown name is an error here, rather than a failure of every pair.
    """
    registry.get(method)
    return partial(register_with, method)


def score(pair: Pair, answer: Answer) -> dict[str, Any]:
    """All metrics of one pair."""
    found, true = answer.T_target_source, pair.T_target_source
    poses = (found, *answer.alternatives)
    return {
        "name": pair.name,
        "rotation_error_deg": float(metrics.rotation_error_deg(found, true)),
        "translation_error": float(metrics.translation_error(found, true)),
        "mean_point_distance": metrics.mean_point_distance(found, true, pair.source),
        "rmse": metrics.rmse(found, true, pair.source),
        "rmse_paper": metrics.rmse_paper(found, true, pair.source),
        "success": metrics.pose_success(found, true, pair.source),
        "geometric_success": metrics.geometric_success(found, true, pair.source, pair.target),
        "any_success": any(metrics.pose_success(pose, true, pair.source) for pose in poses),
        "success_probability": answer.success_probability,
        "alternatives": len(answer.alternatives),
        "error": answer.error,
        "seconds": answer.seconds,
    }


def run_one(registrar: Registrar, pair: Pair, seed: int) -> dict[str, Any]:
    """One row: the scores and the CPU and wall seconds of the registration alone."""
    cpu, wall = time.process_time(), time.perf_counter()
    answer = registrar(pair, seed)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    return {**score(pair, answer), "cpu_seconds": cpu, "wall_seconds": wall}


def run_pairs(
    registrar: Registrar, pairs: Sequence[Pair], *, seed: int, workers: int
) -> list[dict[str, Any]]:
    """One row per pair, in order, from processes of one thread each."""
    for variable in THREAD_VARIABLES:
        os.environ[variable] = "1"
    # Spawned, not forked: a fresh process reads the thread limits before it loads its libraries.
    with ProcessPoolExecutor(
        max_workers=workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_warm_up,
        initargs=(registrar, pairs[0]),
    ) as pool:
        jobs = [pool.submit(run_one, registrar, pair, seed) for pair in pairs]
        return [job.result() for job in jobs]


def _warm_up(registrar: Registrar, pair: Pair) -> None:
    # Imports and first-call set-up are not part of a registration's time.
    registrar(pair, 0)


def values(rows: Iterable[dict[str, Any]], key: str) -> np.ndarray:
    """One column of the rows as floats."""
    return np.array([row[key] for row in rows], dtype=np.float64)


def summarize(rows: Sequence[dict[str, Any]], *, seed: int) -> dict[str, Any]:
    """Means, medians, shares and calibration over all rows, failures included."""
    rotation = values(rows, "rotation_error_deg")
    rng = np.random.default_rng(seed)
    summary: dict[str, Any] = {
        "n": len(rows),
        "seed": seed,
        "mean_deg": float(rotation.mean()),
        "mean_deg_interval": metrics.bootstrap_interval(rotation, rng),
        "median_deg": float(np.median(rotation)),
        "recall_0.1deg": metrics.recall(rotation, 0.1),
        "recall_1deg": metrics.recall(rotation, 1.0),
        "recall_5deg": metrics.recall(rotation, 5.0),
        "recall_5deg_interval": metrics.bootstrap_interval(rotation < 5.0, rng),
        "recall_10deg": metrics.recall(rotation, 10.0),
        "recall_0.1_distance": metrics.recall(values(rows, "mean_point_distance"), 0.1),
        "mean_translation_error": float(values(rows, "translation_error").mean()),
        "median_translation_error": float(np.median(values(rows, "translation_error"))),
        "success": float(values(rows, "success").mean()),
        "any_success": float(values(rows, "any_success").mean()),
        "geometric_success": float(values(rows, "geometric_success").mean()),
        "errors": sum(row["error"] is not None for row in rows),
        "cpu_seconds_median": float(np.median(values(rows, "cpu_seconds"))),
        "cpu_seconds_mean": float(values(rows, "cpu_seconds").mean()),
    }
    for key in ("mean_point_distance", "rmse", "rmse_paper"):
        summary[f"mean_{key}"] = float(values(rows, key).mean())
        summary[f"median_{key}"] = float(np.median(values(rows, key)))
    if all(row["success_probability"] is not None for row in rows):
        probability = values(rows, "success_probability")
        success = values(rows, "success").astype(bool)
        summary["mean_probability"] = float(probability.mean())
        summary["calibration_error"] = metrics.expected_calibration_error(probability, success)
        summary["brier"] = metrics.brier(probability, success)
        coverage, risk = metrics.risk_coverage(probability, success)
        summary["risk_coverage"] = {
            f"{level:.1f}": float(risk[np.searchsorted(coverage, level - 1e-12)])
            for level in np.arange(1, 11) / 10
        }
    return summary


SUMMARY_HEADER = (
    "set", "n", "mean °", "median °", "<0.1°", "<1°", "<5°", "success", "geometric",
    "in list", "probability", "ECE", "CPU s", "refused",
)  # fmt: skip


def summary_cells(label: str, summary: dict[str, Any]) -> list[str]:
    """One row under `SUMMARY_HEADER`; brackets hold 95 % bootstrap intervals."""
    low, high = summary["mean_deg_interval"]
    low5, high5 = summary["recall_5deg_interval"]
    return [
        label,
        str(summary["n"]),
        f"{summary['mean_deg']:.2f} [{low:.2f}, {high:.2f}]",
        f"{summary['median_deg']:.3f}",
        percent(summary["recall_0.1deg"]),
        percent(summary["recall_1deg"]),
        f"{percent(summary['recall_5deg'])} [{percent(low5)}, {percent(high5)}]",
        percent(summary["success"]),
        percent(summary["geometric_success"]),
        percent(summary["any_success"]),
        f"{summary['mean_probability']:.3f}" if "mean_probability" in summary else "–",
        f"{summary['calibration_error']:.3f}" if "calibration_error" in summary else "–",
        f"{summary['cpu_seconds_median']:.3f}",
        str(summary["errors"]),
    ]


def percent(share: float) -> str:
    """A share in percent, one decimal."""
    return f"{100.0 * share:.1f}"


def markdown_table(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A Markdown table with right-aligned numbers."""
    rule = ["---", *["---:"] * (len(header) - 1)]
    return "\n".join("| " + " | ".join(line) + " |" for line in [header, rule, *lines]) + "\n"


def write_results(out: Path, name: str, report: dict[str, Any], text: str) -> None:
    """Write `name`.json with everything and `name`.md with the tables, and print the tables."""
    out.mkdir(parents=True, exist_ok=True)
    machine = {"python": platform.python_version(), "processor": _processor(), "threads": 1}
    content = json.dumps({**report, "machine": machine}, indent=1, default=_plain)
    (out / f"{name}.json").write_text(content + "\n")
    (out / f"{name}.md").write_text(text)
    print(text)


def argument_parser(description: str, *, count: int, name: str) -> argparse.ArgumentParser:
    """The options that all benchmarks have."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--method", default="consensus", help="a registered method")
    parser.add_argument("--count", type=int, default=count, help="pairs per set")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1, help="processes, one thread each")
    parser.add_argument("--name", default=name, help="stem of the result files")
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument(
        "--data",
        type=Path,
        default=os.environ.get("FULLTURN_DATA"),
        help="folder with the data packs; default: the environment variable FULLTURN_DATA",
    )
    return parser


def data_folder(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> Path:
    """The data folder, or a usage error."""
    if arguments.data is None:
        parser.error("pass --data DIR or set FULLTURN_DATA to the folder with the data packs")
    return Path(arguments.data)


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor()


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"cannot write {type(value).__name__} to JSON")
