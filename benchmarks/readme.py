"""Write the numbers of the README from the committed results, so that none is typed by hand.

    python benchmarks/readme.py

Reads the run folders results/{modelnet,scans,mvp-rg,mvp-rg-blind,calibration} and
results/speed.json, and rewrites what stands between the two marks in README.md. What is missing
leaves its part out.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fullturn.evaluation import paper
from fullturn.evaluation.folders import MethodResult, SetResult, read_runs
from fullturn.evaluation.layout import Table, markdown
from fullturn.evaluation.tables import main_table
from marked import rewrite, wrapped

BEGIN, END = "<!-- benchmark:start -->", "<!-- benchmark:end -->"
ROOT = Path(__file__).resolve().parents[1]
METHODS = {
    "consensus": "fullturn",
    "icp-point": "ICP, point to point",
    "icp-plane": "ICP, point to plane",
    "gicp": "GICP (small_gicp)",
    "ransac": "FPFH, RANSAC and ICP (Open3D)",
    "ransac-4m": "the same, 4 million rounds",
    "fgr": "Fast Global Registration (Open3D)",
    "kiss": "KISS-Matcher",
}
LOCAL = ("icp-point", "icp-plane", "gicp")  # from any start they can only fail
HANDCRAFTED = "consensus-histogram"  # has a table of its own
SAME_SAMPLE_180 = {
    "modelnet40/clean/180": "clean",
    "modelnet40/noisy/180": "noise",
}
SEPARATE_180 = {
    "modelnet40/noisy-resampled/180": "noise, two samples of the surface",
    "geotransformer/180": "noise, each scan cropped from a side of its own",
}
UP_TO_45 = {
    "modelnet40/clean/45": ("one sample", "clean"),
    "modelnet40/noisy/45": ("one sample", "noise"),
    "modelnet40/clean/45/unseen": ("one sample", "clean, unseen"),
    "modelnet40/noisy/45/unseen": ("one sample", "noise, unseen"),
    "rpmnet/45": ("two samples", "70 % kept"),
    "predator/45": ("two samples", "50 % kept"),
}
MVP_RG = {
    "mvp-rg/built": "all pairs",
    "match high, any rotation": "overlap 60 % and more",
    "match low, any rotation": "overlap 30 to 60 %",
    "mvp-rg/built/blind": "all pairs, methods not told where the sensors stood",
}
DESCRIPTORS = {  # a set or a group of one: what it is called
    "modelnet40/noisy-resampled/180": "two samples",
    "geotransformer/180": "70 % kept",
    "predator/45": "50 % kept, up to 45°",
    "mvp-rg/built": "two virtual scans",
    "overlap 0.1 to 0.3": "real scans, overlap 10 to 30 %",
}
OVERLAPS = {
    "overlap 0.6 and more": "overlap 60 % and more",
    "overlap 0.3 to 0.6": "overlap 30 to 60 %",
    "overlap 0.1 to 0.3": "overlap 10 to 30 %",
}


def section(results: Path) -> str:
    """The Markdown between the marks; empty where there are no results."""
    parts = (
        modelnet_part, scans_part, mvp_part, descriptor_part, calibration_part, speed_part,
    )  # fmt: skip
    texts = [text for part in parts if (text := part(results))]
    if not texts:
        return ""
    opening = wrapped(
        "Mean and median rotation error; the share of pairs within 5°; the share that is *right*, "
        "which means within 5° and 5 % of the radius; the share that fits the clouds as well as "
        "the true pose does (*geometric*), symmetric poses included; the mean probability that the "
        "method *said*, which should equal the share that is right; and the median CPU seconds of "
        "a pair on one thread. A method that fails counts, as the identity. "
        "`make results DATA=DIR` makes all of [results](results) again, and this section of them."
    )
    return "\n".join(["## Measured\n", opening, *texts])


def modelnet_part(results: Path) -> str:
    """ModelNet40 shapes, with the paper's numbers."""
    sets = load(results / "modelnet")
    tables = {
        "Any rotation; both clouds hold the same points of the surface, which no two scans do. "
        "These numbers say nothing about separate scans:": tables_of(sets, SAME_SAMPLE_180),
        "Any rotation; each cloud is sampled on its own, as a scanner does. The paper has no "
        "numbers for these:": tables_of(sets, SEPARATE_180),
        "Rotations up to 45°, mean error and share within 5°. fullturn is told how far the scans "
        "can be turned (`max_rotation_deg`), as networks know it that are trained in that range; "
        "the other methods here can't be told. The sets of one sample and those of two are "
        "different tasks:": narrow_table(sets),
    }
    parts = [f"{wrapped(text)}\n{table}" for text, table in tables.items() if table]
    if not parts:
        return ""
    opening = wrapped(
        "**ModelNet40**, partial clouds of 768 points (717 where each scan is cropped on its own). "
        "The published numbers are for all 40 categories; here it is a part of them, mostly "
        "airplanes and bathtubs, so they are a landmark and no comparison."
    )
    return "\n".join([opening, *parts, *full_tables_link(results / "modelnet")])


def scans_part(results: Path) -> str:
    """Real range scans by overlap."""
    sets = [
        replace(found, groups={g: found.groups[g] for g in OVERLAPS if g in found.groups})
        for found in load(results / "scans")
        if found.name == "stanford"
    ]
    table = tables_of(sets, {"stanford": "", **OVERLAPS})
    if not table:
        return ""
    opening = wrapped(
        "**Real range scans**, the Stanford bunny and dragon, 15,000 to 44,000 points each, every "
        "pair by how much the scans share, against Stanford's own alignment:"
    )
    return "\n".join([opening, table, *full_tables_link(results / "scans")])


def mvp_part(results: Path) -> str:
    """Pairs of virtual scans."""
    told = [
        replace(one, groups={g: one.groups[g] for g in MVP_RG if g in one.groups})
        for one in load(results / "mvp-rg")
    ]
    blind = [replace(one, groups={}) for one in load(results / "mvp-rg-blind")]
    table = tables_of(told + blind, MVP_RG)
    if not table:
        return ""
    opening = wrapped(
        "**Virtual scans**, an MVP-RG set built here: two of 26 views of an object, 2,048 points "
        "each, any rotation. The shapes are other ones than those of the published set, many of "
        "them nearly symmetric, so the published number is a landmark and no comparison:"
    )
    return "\n".join([opening, table, *full_tables_link(results / "mvp-rg")])


def descriptor_part(results: Path) -> str:
    """The network against the handcrafted descriptor, in the same search."""
    runs = [one for run in ("modelnet", "scans", "mvp-rg") for one in load(results / run)]
    found = {one.name: one.methods for one in runs}
    found |= {group: methods for one in runs for group, methods in one.groups.items()}
    sets = {name: found[name] for name in DESCRIPTORS if HANDCRAFTED in found.get(name, {})}
    if not sets:
        return ""
    rows = []
    for method, title in (("consensus", "network"), (HANDCRAFTED, "handcrafted")):
        cells = (
            f"{percent(one[method].summary['recall_5deg'])}, {one[method].cpu_seconds or 0:.2f} s"
            for one in sets.values()
        )
        rows.append((title, *cells))
    header = (("descriptor",), *((DESCRIPTORS[name],) for name in sets))
    text = wrapped(
        "**The descriptor network** against the handcrafted descriptor that it replaced: share "
        "within 5°, and CPU seconds:"
    )
    return f"{text}\n{markdown(Table('descriptor', 'Descriptor', header, tuple(rows)))}"


def calibration_part(results: Path) -> str:
    """How well the probabilities fit."""
    sets = [found for found in load(results / "calibration") if "consensus" in found.methods]
    if not sets:
        return ""
    summary = sets[0].methods["consensus"].summary
    text = (
        f"**The probability**, on {summary['n']:,} pairs of many kinds, made of shapes that it "
        f"was not fit on: it says {percent(summary['mean_probability'])} on average and is right "
        f"in {percent(shares_right(summary))}; the expected calibration error is "
        f"{summary['calibration_error']:.3f}."
    )
    if summary["unrelated"]:
        text += (
            f" Of the {summary['unrelated']} pairs of different objects among them, "
            f"{percent(summary['unrelated_at_most_0.2'])} get at most 0.2."
        )
    return "\n".join([wrapped(text), *full_tables_link(results / "calibration")])


def speed_part(results: Path) -> str:
    """Time and memory by size."""
    path = results / "speed.json"
    if not path.exists():
        return ""
    report = json.loads(path.read_text(encoding="utf-8"))
    rows = tuple(
        (f"{row['points']:,}", f"{row['cpu_seconds']:.2f}", f"{row['peak_mib']:,.0f}")
        for row in report["sizes"]
    )
    header = (("points per scan",), ("CPU s",), ("peak memory, MiB",))
    return (
        f"**Speed** on one thread ({report['machine']['processor']}).\n\n"
        f"{markdown(Table('speed', 'Speed', header, rows))}\n"
        f"`python benchmarks/speed.py --method {report['method']} --seed {report['seed']}`\n"
    )


def load(folder: Path) -> list[SetResult]:
    """The sets of a run folder; none where there is no such folder."""
    return read_runs([folder]) if folder.exists() else []


def tables_of(sets: Sequence[SetResult], titles: dict[str, str]) -> str:
    """The table of the sets that have a title, in the titles' order, with its seeds; or "".

    Only of methods that search all rotations.
    """
    by_name = {found.name: without_local(found) for found in sets}
    chosen = [by_name[name] for name in titles if name in by_name]
    if not chosen:
        return ""
    table = main_table(chosen, methods=METHODS, titles=titles)
    return f"{markdown(table)}\n{wrapped(table.notes[0])}"


def without_local(found: SetResult) -> SetResult:
    """The results of the methods that need no rough alignment."""

    def chosen(methods: Mapping[str, MethodResult]) -> dict[str, MethodResult]:
        hidden = (*LOCAL, HANDCRAFTED)
        return {name: one for name, one in methods.items() if name not in hidden}

    groups = {group: chosen(methods) for group, methods in found.groups.items()}
    return replace(found, methods=chosen(found.methods), groups=groups)


def narrow_table(sets: Sequence[SetResult]) -> str:
    """Rotations up to 45°: a row a method, a column a set."""
    by_name = {found.name: found for found in sets if found.name in UP_TO_45}
    names = [name for name in UP_TO_45 if name in by_name]
    if not names:
        return ""
    methods = dict.fromkeys(m for name in names for m in by_name[name].methods if m != HANDCRAFTED)
    rows = [
        (METHODS.get(method, method), *(narrow_cell(by_name[n].methods.get(method)) for n in names))
        for method in methods
    ]
    best = [paper.best_row(name) for name in names]
    published = (
        f"{row.figures[name]['rotation_error_deg'].text}°" if row else "–"
        for row, name in zip(best, names, strict=True)
    )
    rows.append((paper.LABEL, *published))
    header = [("", "method")]
    for name in names:
        sampling, title = UP_TO_45[name]
        header.append((sampling, f"{title} ({by_name[name].count})"))
    return markdown(Table("narrow", "Up to 45°", tuple(header), tuple(rows)))


def narrow_cell(found: MethodResult | None) -> str:
    """Mean error and share within 5°."""
    if found is None:
        return "–"
    summary = found.summary
    return f"{summary['mean_deg']:.2f}°, {percent(summary['recall_5deg'])}"


def shares_right(summary: Mapping[str, Any]) -> float:
    """The share of all pairs that is right; of unrelated ones, no answer is."""
    return summary["success"] * (1.0 - summary["unrelated"] / summary["n"])


def full_tables_link(folder: Path) -> list[str]:
    """Where the full tables are, if `fullturn table` has written them."""
    if not (folder / "tables.md").exists():
        return []
    return [f"[All numbers of these runs](results/{folder.name}/tables.md)\n"]


def percent(share: float) -> str:
    """A share in percent, one decimal."""
    return f"{100.0 * share:.1f} %"


def main() -> None:
    """Rewrite the README."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=ROOT / "results")
    parser.add_argument("--readme", type=Path, default=ROOT / "README.md")
    arguments = parser.parse_args()
    readme = arguments.readme.read_text(encoding="utf-8")
    arguments.readme.write_text(
        rewrite(readme, section(arguments.results), begin=BEGIN, end=END), encoding="utf-8"
    )


if __name__ == "__main__":
    main()
