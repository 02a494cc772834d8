"""CPU seconds and memory of one registration against the number of points, one thread.

    python benchmarks/speed.py --method consensus --sizes 768 2048 20000 1000000

The pair is made from the demo object (no data needed): two samples, cropped by one far viewpoint,
with noise. Each size runs in its own process, after a warm-up on a small pair; the median of the
repetitions is reported. Peak memory is that of the process, the imports' share is given beside it.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fullturn.data.motion import ball_translation, uniform_rotation
from fullturn.data.pair import Pair
from fullturn.data.perturb import crop_nearest, far_viewpoint, jitter, resample
from fullturn.data.procedural import demo_object
from fullturn.data.surface import sample_surface
from fullturn.evaluation.layout import Table, markdown
from fullturn.evaluation.metrics import rotation_error_deg
from fullturn.evaluation.run import machine
from fullturn.geometry.motion import move, rigid
from fullturn.workers import THREAD_VARIABLES

SIZES = (768, 2_048, 20_000, 1_000_000)


def make_pair(count: int, *, seed: int) -> Pair:
    """Two noisy, cropped samples of the demo object, `count` points each."""
    rng = np.random.default_rng(seed)
    mesh = demo_object()
    T_target_source = rigid(uniform_rotation(rng), ball_translation(rng, max_length=1.0))
    viewpoint = far_viewpoint(rng)
    source, target = (
        resample(crop_nearest(points, viewpoint, keep=count), rng, count=count)
        for points in (sample_surface(mesh, count * 4 // 3, rng) for _ in range(2))
    )
    return Pair(
        jitter(source, rng, sigma=0.003, clip=0.015),
        jitter(move(T_target_source, target), rng, sigma=0.003, clip=0.015),
        T_target_source,
        f"demo_{count}",
    )


def measure(method: str, count: int, *, seed: int, repetitions: int) -> dict[str, Any]:
    """Time and memory of one size, in this process: the whole call, explanation included."""
    import fullturn

    small, pair = make_pair(min(count, 768), seed=seed + 1), make_pair(count, seed=seed)
    fullturn.register(small.source, small.target, method=method, seed=seed)
    before = _peak_mib()
    cpu_seconds, stages = [], []
    for _ in range(repetitions):
        start = time.process_time()
        result = fullturn.register(pair.source, pair.target, method=method, seed=seed)
        cpu_seconds.append(time.process_time() - start)
        stages.append(result.seconds)
    return {
        "points": count,
        "repetitions": repetitions,
        "cpu_seconds": float(np.median(cpu_seconds)),
        "peak_mib": _peak_mib(),
        "peak_mib_before": before,
        "stages": {
            stage: float(np.median([seconds[stage] for seconds in stages])) for stage in stages[0]
        },
        "rotation_error_deg": float(
            rotation_error_deg(result.T_target_source, pair.T_target_source)
        ),
    }


def report(rows: list[dict[str, Any]], *, method: str, seed: int, out: Path, name: str) -> None:
    """Tables of totals, of stages and of the growth from size to size."""
    lines = []
    for i, row in enumerate(rows):
        growth = "–"
        if i > 0:
            last = rows[i - 1]
            exponent = np.log(row["cpu_seconds"] / last["cpu_seconds"]) / np.log(
                row["points"] / last["points"]
            )
            growth = f"n^{exponent:.2f}"
        lines.append(
            [
                f"{row['points']:,}",
                f"{row['cpu_seconds']:.3f}",
                growth,
                f"{row['peak_mib']:.0f}",
                f"{row['peak_mib'] - row['peak_mib_before']:.0f}",
                f"{row['rotation_error_deg']:.3f}",
            ]
        )
    totals = _table(("points", "CPU s", "growth", "peak MiB", "MiB above start", "error °"), lines)
    stages = list(dict.fromkeys(stage for row in rows for stage in row["stages"]))
    by_stage = _table(
        ("wall seconds of stage", *(f"{row['points']:,}" for row in rows)),
        [[stage, *(f"{row['stages'].get(stage, 0.0):.4f}" for row in rows)] for stage in stages],
    )
    text = f"# Speed: {method}, seed {seed}, one thread\n\n{totals}\n{by_stage}"
    content = {"method": method, "seed": seed, "sizes": rows, "machine": machine()}
    out.mkdir(parents=True, exist_ok=True)
    (out / f"{name}.json").write_text(json.dumps(content, indent=1) + "\n")
    (out / f"{name}.md").write_text(text)
    print(text)


def _table(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    heads, rows = tuple((head,) for head in header), tuple(tuple(line) for line in lines)
    return markdown(Table("speed", "Speed", heads, rows))


def main() -> None:
    """Measure all sizes, each in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--method", default="consensus", help="a registered method")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--name", default="speed", help="stem of the result files")
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--one", type=int, help="measure this size here and print JSON")
    arguments = parser.parse_args()
    if arguments.one is not None:
        row = measure(
            arguments.method,
            arguments.one,
            seed=arguments.seed,
            repetitions=arguments.repetitions,
        )
        print(json.dumps(row))
        return
    environment = {**os.environ, **dict.fromkeys(THREAD_VARIABLES, "1")}
    rows = []
    for size in arguments.sizes:
        command = [sys.executable, __file__, "--one", str(size), "--method", arguments.method]
        command += ["--seed", str(arguments.seed), "--repetitions", str(arguments.repetitions)]
        done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True)
        rows.append(json.loads(done.stdout.splitlines()[-1]))
    report(
        rows,
        method=arguments.method,
        seed=arguments.seed,
        out=arguments.out,
        name=arguments.name,
    )


def _peak_mib() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # Kibibytes on Linux, bytes on macOS.
    return peak / 1024 if sys.platform != "darwin" else peak / 1024**2


if __name__ == "__main__":
    main()
