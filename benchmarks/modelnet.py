"""Benchmark a method on the ModelNet40 protocols.

    python benchmarks/modelnet.py --data DIR --method consensus --count 300 --seed 0

The set is a part of ModelNet40 (148 shapes, mostly airplanes and bathtubs): a score on it is not a
ModelNet40 score. Same-sample and resampled rows measure different things.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from common import (
    SUMMARY_HEADER,
    Registrar,
    argument_parser,
    data_folder,
    fullturn_registrar,
    markdown_table,
    run_pairs,
    summarize,
    summary_cells,
    write_results,
)
from fullturn.data.protocols import PROTOCOLS, make_pairs
from fullturn.data.shapes import ModelNetSubset

DEFAULT_PROTOCOLS = (
    "modelnet40/clean/180",
    "modelnet40/noisy/180",
    "modelnet40/noisy-resampled/180",
    "geotransformer/180",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this benchmark alone."""
    parser.add_argument("--protocol", nargs="+", choices=PROTOCOLS, default=DEFAULT_PROTOCOLS)
    parser.add_argument("--use", default="dev_eval", help="which part of the pack")


def run(registrar: Registrar, label: str, arguments: argparse.Namespace, data: Path) -> None:
    """Run all protocols and write the results."""
    shapes = ModelNetSubset(data / "modelnet40_subset.npz", use=arguments.use)
    report: dict[str, dict] = {}
    for name in arguments.protocol:
        pairs = list(
            make_pairs(PROTOCOLS[name], shapes, count=arguments.count, seed=arguments.seed)
        )
        rows = run_pairs(registrar, pairs, seed=arguments.seed, workers=arguments.workers)
        report[name] = {"summary": summarize(rows, seed=arguments.seed), "pairs": rows}
    table = markdown_table(
        SUMMARY_HEADER, [summary_cells(name, part["summary"]) for name, part in report.items()]
    )
    write_results(
        arguments.out,
        arguments.name,
        {"method": label, "seed": arguments.seed, "use": arguments.use, "sets": report},
        f"# ModelNet40 protocols: {label}, seed {arguments.seed}\n\n{table}",
    )


def main() -> None:
    """Benchmark a registered method."""
    parser = argument_parser(__doc__.splitlines()[0], count=300, name="modelnet")
    add_arguments(parser)
    arguments = parser.parse_args()
    run(
        fullturn_registrar(arguments.method),
        arguments.method,
        arguments,
        data_folder(parser, arguments),
    )


if __name__ == "__main__":
    main()
