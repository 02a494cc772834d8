"""Write the numbers of the README from the committed results, so that none is typed by hand.

    python benchmarks/tables.py

Reads results/{modelnet,real_scans,speed}.json and the open3d_*.json beside them, and rewrites what
stands between the two marks in README.md. A missing file leaves its table, or its rows, out.
"""

from __future__ import annotations

import argparse
import json
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from common import markdown_table, percent

BEGIN, END = "<!-- benchmark:start -->", "<!-- benchmark:end -->"
ROOT = Path(__file__).resolve().parents[1]
# Mean rotation errors in degrees from the tables of the GMCNet paper, rotations up to 180°.
PAPER = {"modelnet40/clean/180": "0.036", "modelnet40/noisy/180": "18.13"}
SETS = {
    "modelnet40/clean/180": "clean",
    "modelnet40/noisy/180": "noise",
    "modelnet40/noisy-resampled/180": "noise, two samples of the surface",
    "geotransformer/180": "noise, each scan cropped from a side of its own",
}
OVERLAPS = {
    "overlap 0.6 and more": "60 % and more",
    "overlap 0.3 to 0.6": "30 to 60 %",
    "overlap 0.1 to 0.3": "10 to 30 %",
}
HEADER = ("pairs", "method", "mean °", "median °", "within 5°", "right", "said", "CPU s")


def section(results: Path) -> str:
    """The Markdown between the marks; empty where there are no results."""
    parts = [part(results) for part in (modelnet_part, scans_part, speed_part)]
    parts = [part for part in parts if part]
    if not parts:
        return ""
    opening = paragraph(
        "Mean and median rotation error; the share of pairs *within 5°*; the share that is "
        "*right*, which means within 5° and 5 % of the radius; the mean probability that the "
        "method *said*, which should equal the share that is right; and the median CPU seconds of "
        "a pair on one thread. Open3D is FPFH, RANSAC with 100,000 rounds and ICP on the same "
        "pairs (`benchmarks/open3d_baseline.py`)."
    )
    return "\n".join(["## Measured\n", opening, *parts])


def modelnet_part(results: Path) -> str:
    """ModelNet40 shapes, with the paper's numbers."""
    reports = load(results, fullturn="modelnet", Open3D="open3d_modelnet")
    if not reports:
        return ""
    lines = []
    for key, title in SETS.items():
        sets = {name: report["sets"][key] for name, report in reports if key in report["sets"]}
        check_same_pairs(key, {name: part["pairs"] for name, part in sets.items()})
        summaries = {name: part["summary"] for name, part in sets.items()}
        lines += list(rows(title, summaries))
        if key in PAPER and summaries:
            lines.append(["", "GMCNet, as published", PAPER[key], *["–"] * 5])
    opening = paragraph(
        "**ModelNet40**, partial clouds of 768 points (717 in the last rows), any rotation. In the "
        "first two sets both clouds hold the same points of the surface, which no two scans do. "
        "The published numbers are for all 40 categories; here it is a part of them, mostly "
        "airplanes and bathtubs, so they are a landmark and no comparison."
    )
    return f"{opening}\n{markdown_table(HEADER, lines)}\n{command('modelnet', reports[0][1])}\n"


def scans_part(results: Path) -> str:
    """Real range scans by overlap."""
    reports = load(
        results,
        fullturn="real_scans",
        Open3D="open3d_real_scans",
        **{"Open3D, thinned": "open3d_real_scans_voxel"},
    )
    if not reports:
        return ""
    check_same_pairs("real scans", {name: report["pairs"] for name, report in reports})
    lines = []
    for key, title in OVERLAPS.items():
        found = {name: r["summaries"][key] for name, r in reports if key in r["summaries"]}
        lines += list(rows(f"overlap {title}", found))
    opening = paragraph(
        "**Real range scans**, the Stanford bunny and dragon, 15,000 to 44,000 points each, every "
        "pair by how much the scans share, against Stanford's own alignment. *Thinned* is by a "
        "grid of 5 % of the radius."
    )
    return f"{opening}\n{markdown_table(HEADER, lines)}\n{command('real_scans', reports[0][1])}\n"


def speed_part(results: Path) -> str:
    """Time and memory by size."""
    reports = load(results, fullturn="speed")
    if not reports:
        return ""
    report = reports[0][1]
    lines = [
        [f"{row['points']:,}", f"{row['cpu_seconds']:.2f}", f"{row['peak_mib']:,.0f}"]
        for row in report["sizes"]
    ]
    return (
        f"**Speed** on one thread ({report['machine']['processor']}).\n\n"
        f"{markdown_table(('points per scan', 'CPU s', 'peak memory, MiB'), lines)}\n"
        f"{command('speed', report)}\n"
    )


def load(results: Path, **stems: str) -> list[tuple[str, dict[str, Any]]]:
    """The reports there are, by name; none without the first one, fullturn's own."""
    paths = {name: results / f"{stem}.json" for name, stem in stems.items()}
    if not next(iter(paths.values())).exists():
        return []
    return [(name, json.loads(path.read_text())) for name, path in paths.items() if path.exists()]


def check_same_pairs(what: str, pairs: dict[str, list[dict[str, Any]]]) -> None:
    """Methods stand beside one another only on the same pairs."""
    names = {method: [row["name"] for row in rows] for method, rows in pairs.items()}
    first = next(iter(names.values()), [])
    for method, others in names.items():
        if others != first:
            raise SystemExit(
                f"{what}: expected the same pairs for all methods, got {len(first)} and, by "
                f"{method}, {len(others)} or others; run the benchmarks with the same --count "
                "and --seed"
            )


def rows(title: str, summaries: dict[str, dict[str, Any]]) -> Iterator[list[str]]:
    """One line per method; the title and the number of pairs stand in the first one alone."""
    for number, (name, summary) in enumerate(summaries.items()):
        said = summary.get("mean_probability")
        yield [
            "" if number else f"{title} ({summary['n']})",
            name,
            f"{summary['mean_deg']:.2f}",
            f"{summary['median_deg']:.2f}",
            f"{percent(summary['recall_5deg'])} %",
            f"{percent(summary['success'])} %",
            "–" if said is None else f"{percent(said)} %",
            f"{summary['cpu_seconds_median']:.2f}",
        ]


def command(script: str, report: dict[str, Any]) -> str:
    """What makes these numbers again."""
    options = "" if script == "speed" else " --data DIR"
    if script == "modelnet":
        options += f" --count {max(part['summary']['n'] for part in report['sets'].values())}"
    options += f" --method {report['method']} --seed {report['seed']}"
    return f"`python benchmarks/{script}.py{options}`"


def paragraph(text: str) -> str:
    """Text wrapped as the README is."""
    return textwrap.fill(text, 100, break_long_words=False, break_on_hyphens=False) + "\n"


def rewrite(readme: str, text: str) -> str:
    """The README with another text between the marks."""
    before, found, rest = readme.partition(BEGIN)
    _, closed, after = rest.partition(END)
    if not (found and closed):
        raise SystemExit(f"README.md: expected {BEGIN} and, later, {END}; put them back")
    return f"{before}{BEGIN}\n{text}{END}{after}"


def main() -> None:
    """Rewrite the README."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=ROOT / "results")
    parser.add_argument("--readme", type=Path, default=ROOT / "README.md")
    arguments = parser.parse_args()
    readme = arguments.readme.read_text(encoding="utf-8")
    arguments.readme.write_text(rewrite(readme, section(arguments.results)), encoding="utf-8")


if __name__ == "__main__":
    main()
