"""Show what still fails: counts of wrong answers by set, and pictures of those said most firmly.

    python benchmarks/limits.py RUN… --data DIR… [--method consensus] [--pictures 8]

RUN are run folders of `fullturn evaluate`; --data are the folders that hold the packs, scans and
built sets that their pairs were made from. Rewrites what stands between the two marks in
docs/limits.md, and draws docs/images/limits_failures.png. The chosen pairs are registered again;
those that come out right by now are passed over. Of some sets, errors are also told by how much the
clouds of a pair overlap.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice, pairwise, zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from fullturn.data.open import open_pairs, open_shapes, protocol_pairs
from fullturn.data.overlap import scan_overlap
from fullturn.data.pair import Pair
from fullturn.data.pair_set import PairSet
from fullturn.errors import FullturnError
from fullturn.evaluation.folders import SetResult, read_runs
from fullturn.evaluation.layout import Table, markdown
from fullturn.evaluation.predict import Prediction, predict
from fullturn.evaluation.run import slug
from fullturn.evaluation.score import Score, ScoredPair
from fullturn.evaluation.tables import family
from fullturn.geometry.motion import move
from fullturn.methods.base import Method
from fullturn.methods.registry import get
from fullturn.viz.canvas import new_figure
from fullturn.viz.figures import INK, SOURCE, TARGET, draw_panel, write_figure
from fullturn.viz.scene import thin, viewing_axes
from fullturn.viz.tables import probability
from marked import rewrite, wrapped

BEGIN, END = "<!-- limits:start -->", "<!-- limits:end -->"
ROOT = Path(__file__).resolve().parents[1]
WRONG_DEG = 5.0
CERTAIN = 0.9
POINTS = 2_000  # of each cloud, drawn
BY_OVERLAP = ("predator/45",)  # sets whose errors are told by overlap
OVERLAPS = (0.0, 0.1, 0.2, 0.3, 0.4, 1.0)
HEADER = (
    "pairs",
    "n",
    "wrong",
    "fit as well as the truth",
    "truth among the alternatives",
    "said 0.9 or more",
)


@dataclass(frozen=True)
class Row:
    """One pair of a run, as far as this page asks for it."""

    set: str
    index: int
    name: str
    group: str
    related: bool
    error_deg: float  # NaN where the method failed, or no pose is right
    probability: float
    fits: bool  # as well as the true pose
    among: bool  # the truth is the answer or one of its alternatives

    @property
    def wrong(self) -> bool:
        """Whether the answer is off, or there is none."""
        return not self.error_deg < WRONG_DEG

    @property
    def shape(self) -> str:
        """The object: names of scans begin with it, those of mesh files end with it."""
        parts = self.name.split("/")
        return parts[0] if self.set.startswith("stanford") else "/".join(parts[-2:])[-40:]


@dataclass(frozen=True, eq=False)
class Failure:
    """A wrong answer, made again."""

    row: Row
    pair: Pair
    found: Prediction
    score: Score

    @property
    def line(self) -> str:
        """What the page says of it."""
        fit = (
            "fits as well as the truth" if self.score.geometric_success else "the truth fits better"
        )
        among = "; the truth is among the alternatives" if self.score.any_success else ""
        return (
            f"{self.row.shape} (`{self.row.set}`): {self.score.rotation_error_deg:.0f}° off, said "
            f"{probability(self.found.success_probability or 0.0)}; {fit}{among}."
        )


def read_rows(result: SetResult, method: str) -> list[Row]:
    """The pairs of a set as the run folder holds them."""
    path = result.methods[method].folder / "pairs" / f"{slug(result.name)}.csv"
    with open(path, newline="", encoding="utf-8") as stream:
        cells = [row for row in csv.DictReader(stream) if row["method"] == method]
    return [
        Row(
            set=result.name,
            index=int(row["index"]),
            name=row["name"],
            group=row["group"],
            related=row["related"] == "1",
            error_deg=float((not row["error"] and row["rotation_error_deg"]) or "nan"),
            probability=float(row["success_probability"] or 0.0),
            fits=row["geometric_success"] == "1",
            among=row["any_success"] == "1",
        )
        for row in cells
    ]


def counts_table(sets: Mapping[str, Sequence[Row]]) -> Table:
    """One line a set, of its pairs that have a right pose."""
    lines = []
    for name, rows in sets.items():
        related = [row for row in rows if row.related]
        wrong = [row for row in related if row.wrong]
        said = sum(row.probability >= CERTAIN for row in wrong)
        counts = (len(related), len(wrong), sum(row.fits for row in wrong))
        counts += (sum(row.among for row in wrong), said)
        lines.append((name, *map(str, counts)))
    return Table("limits", "Limits", tuple((head,) for head in HEADER), tuple(lines))


def overlap_table(rows: Sequence[Row], pairs: PairSet) -> Table:
    """Errors of the answers to a set by how much the two clouds of a pair overlap."""
    rows = [row for row in rows if row.related and np.isfinite(row.error_deg)]
    known = (pairs.pair(row.index) for row in rows)
    overlap = np.array([scan_overlap(move(p.T_target_source, p.source), p.target) for p in known])
    error = np.array([row.error_deg for row in rows])
    wrong = np.array([row.wrong for row in rows])
    said = np.array([row.probability for row in rows])
    lines = []
    for low, high in pairwise(OVERLAPS):
        of = (overlap >= low) & ((overlap < high) | (high == OVERLAPS[-1]))
        if of.any():
            name = f"{100 * low:.0f} to {100 * high:.0f} %"
            share = error[of].sum() / len(rows)
            told = (f"{error[of].mean():.2f}°", f"{share:.2f}°", f"{said[of].mean():.2f}")
            lines.append((name, str(of.sum()), str(wrong[of].sum()), *told))
    header = ("overlap", "n", "wrong", "mean error", "of the set's mean", "mean probability")
    return Table("overlap", "By overlap", tuple((head,) for head in header), tuple(lines))


def unrelated_lines(sets: Mapping[str, Sequence[Row]]) -> list[str]:
    """What is said of two different objects, a line a set that has such pairs."""
    lines = []
    for name, rows in sets.items():
        said = np.array([row.probability for row in rows if not row.related])
        if len(said):
            lines.append(
                f"Two different objects (`{name}`): of {len(said)} pairs, {(said > 0.2).sum()} get "
                f"more than 0.2, {(said > 0.5).sum()} more than 0.5, and {(said >= CERTAIN).sum()} "
                f"{CERTAIN} or more."
            )
    return lines


def candidates(sets: Mapping[str, Sequence[Row]]) -> Iterator[Row]:
    """Wrong answers, one of each kind in turn, the most firmly said first, one a shape.

    A kind is a group of a set, or a family of sets, and whether the answer fits.
    """
    kinds: dict[tuple[str, bool], list[Row]] = {}
    for row in sorted(chain(*sets.values()), key=lambda row: -row.probability):
        if row.related and row.wrong:
            kinds.setdefault((row.group or family(row.set), row.fits), []).append(row)
    seen = set()
    for row in filter(None, chain(*zip_longest(*kinds.values()))):
        if row.shape not in seen:
            seen.add(row.shape)
            yield row


def fail_again(
    results: Mapping[str, SetResult],
    sets: Mapping[str, Sequence[Row]],
    method: Method,
    *,
    folders: Sequence[Path],
) -> Iterator[Failure]:
    """The candidates whose pairs are to be had and that the method still gets wrong."""
    opened: dict[str, PairSet | None] = {}
    for row in candidates(sets):
        result = results[row.set]
        if row.set not in opened:
            opened[row.set] = reopen(result.description, row.set, folders)
        pairs = opened[row.set]
        if pairs is None:
            continue
        pair = pairs.pair(row.index)
        found = predict(method, pair, seed=result.methods[method.name].seed)
        score = ScoredPair(pair, index=row.index).score(found)
        if score.error is None and (score.rotation_error_deg or 0.0) >= WRONG_DEG:
            yield Failure(row, pair, found, score)


def reopen(description: Mapping[str, Any], name: str, folders: Sequence[Path]) -> PairSet | None:
    """The pairs of a set from what the run says of them; None where they aren't to be had.

    Not of sets that keep something back: they show the pairs of another one.
    """
    if description.get("known"):
        return None
    try:
        sources = description.get("shapes", [])
        if description["kind"] in ("protocol", "mixture"):
            (first, *more) = [sources] if isinstance(sources, Mapping) else sources
            if more:
                return None
            shapes = open_shapes(_spec(first, folders))
            sizes = {"count": description["count"], "seed": description["seed"]}
            ((pairs,), _) = protocol_pairs([name], shapes, **sizes)
        else:
            pairs = open_pairs(_spec(description, folders))
    except FullturnError as error:
        print(f"{name}: no pictures; {error}")
        return None
    if pairs.name != name or not _agree(description, pairs.description):
        print(f"{name}: no pictures; its pairs are made in another way by now")
        return None
    return pairs


def _spec(description: Mapping[str, Any], folders: Sequence[Path]) -> str:
    """How to name shapes or pairs on the command line."""
    if description["kind"] == "procedural":
        return f"procedural:{description['count']}:{description['seed']}"
    file = description["file"]
    place = next((folder / file for folder in folders if (folder / file).exists()), Path(file))
    return f"{place}:{description['part']}" if description.get("part") else str(place)


def _agree(first: Any, second: Any) -> bool:
    """Whether two descriptions say the same where both say something."""
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        return all(_agree(first[key], second[key]) for key in first.keys() & second.keys())
    return bool(first == second)


def draw(failures: Sequence[Failure]) -> Figure:
    """Each failure under the pose that was found, and under the true one."""
    rows = -(-len(failures) // 2)
    figure = new_figure(figsize=(12.0, 2.9 * rows), layout="constrained")
    spots = figure.subfigures(rows, 2, squeeze=False).ravel()
    for number, (spot, failure) in enumerate(zip(spots, failures, strict=False), start=1):
        score, pair = failure.score, failure.pair
        source, target = thin(pair.source, POINTS), thin(pair.target, POINTS)
        axes = viewing_axes(np.concatenate([move(pair.T_target_source, source), target]))
        colors = np.repeat([to_rgb(SOURCE), to_rgb(TARGET)], [len(source), len(target)], axis=0)
        poses = {"found": failure.found.T_target_source, "true": pair.T_target_source}
        shown = [np.concatenate([move(T, source), target]) @ axes.T for T in poses.values()]
        height = max(float(np.ptp(points[:, :2], axis=0).max()) for points in shown)
        for panel, name, points in zip(spot.subplots(1, 2), poses, shown, strict=True):
            draw_panel(panel, name, points, colors, height=height)
        said = probability(failure.found.success_probability or 0.0)
        title = f"{number}. {failure.row.shape}: {score.rotation_error_deg:.0f}° off, said {said}"
        spot.suptitle(f"{title}\n{failure.row.set}", color=INK, fontsize=10)
    return figure


def section(
    sets: Mapping[str, Sequence[Row]],
    overlaps: Mapping[str, Table],
    failures: Sequence[Failure],
    picture: str,
) -> str:
    """The Markdown between the marks."""
    parts = [markdown(counts_table(sets))]
    for name, table in overlaps.items():
        parts += [wrapped(f"`{name}`, by the overlap of the two clouds:"), markdown(table)]
    parts += [wrapped(line) for line in unrelated_lines(sets)]
    if failures:
        parts.append(f"![Wrong poses beside the true ones]({picture})\n")
        lines = enumerate((failure.line for failure in failures), start=1)
        parts.append("".join(wrapped(f"{number}. {line}", indent="   ") for number, line in lines))
    return "\n" + "\n".join(parts) + "\n"


def main() -> None:
    """Count, choose, register again, draw, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--data", type=Path, nargs="+", default=[])
    parser.add_argument("--method", default="consensus")
    parser.add_argument("--pictures", type=int, default=8)
    parser.add_argument("--docs", type=Path, default=ROOT / "docs")
    told = parser.parse_args()
    results = {r.name: r for r in read_runs(told.runs) if told.method in r.methods}
    sets = {name: read_rows(result, told.method) for name, result in results.items()}
    again = fail_again(results, sets, get(told.method)(), folders=told.data)
    failures = list(islice(again, told.pictures))
    overlaps = {}
    for name in (name for name in BY_OVERLAP if name in sets):
        pairs = reopen(results[name].description, name, told.data)
        if pairs is not None:
            overlaps[name] = overlap_table(sets[name], pairs)
    picture = "images/limits_failures.png"
    if failures:
        write_figure(told.docs / picture, lambda: draw(failures), dpi=72)
    page = told.docs / "limits.md"
    text = rewrite(
        page.read_text(encoding="utf-8"),
        section(sets, overlaps, failures, picture),
        begin=BEGIN,
        end=END,
    )
    page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
