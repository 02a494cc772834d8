"""Calibration of the success probability on generated pairs of many kinds.

    python benchmarks/calibration.py --count 600 --seed 1000

The shapes come from the package's own generator, near-symmetric ones and symmetric ones included,
the pairs from the mixture that the verdict was fit on, with another seed: none of them was seen in
the fit. Pairs of two different shapes have no right answer; their probability should be low.
"""

from __future__ import annotations

import numpy as np

from common import (
    SUMMARY_HEADER,
    argument_parser,
    fullturn_registrar,
    markdown_table,
    percent,
    run_pairs,
    summarize,
    summary_cells,
    write_results,
)
from fullturn.data.mixture import KINDS, mixed_pair
from fullturn.data.shapes import ProceduralShapes
from fullturn.evaluation import metrics


def main() -> None:
    """Run, score, write."""
    parser = argument_parser(__doc__.splitlines()[0], count=600, name="calibration")
    arguments = parser.parse_args()
    shapes = [ProceduralShapes(100_000, seed=arguments.seed)]
    mixed = [mixed_pair(shapes, seed=arguments.seed, number=i) for i in range(arguments.count)]
    registrar = fullturn_registrar(arguments.method)
    rows = run_pairs(
        registrar, [m.pair for m in mixed], seed=arguments.seed, workers=arguments.workers
    )
    for row, m in zip(rows, mixed, strict=True):
        row["kind"] = m.kind
        row["success"] = row["success"] and m.kind != "unrelated"
        row["any_success"] = row["any_success"] and m.kind != "unrelated"
    stated = np.array([row["success_probability"] for row in rows])
    right = np.array([row["success"] for row in rows])
    unrelated = np.array([m.kind == "unrelated" for m in mixed])
    low = float(np.mean(stated[unrelated] <= 0.2)) if unrelated.any() else float("nan")
    error = metrics.expected_calibration_error(stated, right)
    sets = {
        kind: summarize([row for row in rows if row["kind"] == kind], seed=arguments.seed)
        for kind in KINDS
        if any(row["kind"] == kind for row in rows)
    }
    everything = summarize(rows, seed=arguments.seed)
    table = markdown_table(
        SUMMARY_HEADER,
        [summary_cells(name, part) for name, part in {"all": everything, **sets}.items()],
    )
    text = (
        f"# Calibration: {arguments.method}, seed {arguments.seed}\n\n{table}\n\n"
        f"Expected calibration error over all pairs: {error:.3f}. "
        f"Unrelated pairs with a probability of at most 0.2: {percent(low)} %."
    )
    write_results(
        arguments.out,
        arguments.name,
        {
            "method": arguments.method,
            "seed": arguments.seed,
            "expected_calibration_error": error,
            "unrelated_at_most_0.2": low,
            "summary": everything,
            "kinds": sets,
            "pairs": rows,
        },
        text,
    )


if __name__ == "__main__":
    main()
