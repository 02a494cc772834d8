"""Tables from run folders, with the paper's numbers beside ours. No number is typed by hand."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

from fullturn.evaluation import notes, paper
from fullturn.evaluation.folders import MethodResult, SetResult
from fullturn.evaluation.layout import NONE, Table, number, plain_header

# Column → key of the summary, and its form: decimals, "%" for a share, "°" for an angle.
_COLUMNS: dict[str, tuple[str, int | str]] = {
    "mean °": ("mean_deg", "°"),
    "median °": ("median_deg", "°"),
    "<1° %": ("recall_1deg", "%"),
    "<5° %": ("recall_5deg", "%"),
    "right %": ("success", "%"),
    "geometric %": ("geometric_success", "%"),
    "said %": ("mean_probability", "%"),
    "ECE": ("calibration_error", 3),
    "sure %": ("certain", "%"),
    "sure, right %": ("certain_right", "%"),
    "mean t": ("mean_translation_error", 4),
    "mean distance": ("mean_mean_point_distance", 4),
}
_MAIN_COLUMNS = ("mean °", "median °", "<5° %", "right %", "geometric %", "said %")
_PAPER_COLUMNS = {
    "mean °": "rotation_error_deg",
    "mean t": "translation_error",
    "mean distance": "l_rmse",
}
_DIFFERENCES = {"Δ °": "mean °", "Δ t": "mean t", "Δ distance": "mean distance"}
EXPLANATION = (
    "Brackets hold 95 % bootstrap intervals. Right: within 5° and 5 % of the radius. Geometric: "
    "fits the clouds as well as the true pose does, or within 5°. Said: the mean probability that "
    "the method states, which should equal what is right; ECE: expected calibration error. "
    "Sure: the share of pairs that get 0.9 or more; and, of these, the share that is right. "
    "Distance: of a point from where it belongs. Failures count, as the identity. CPU s: median "
    "of a pair on one thread."
)
_FAMILIES = {
    "modelnet40": (
        "ModelNet40 protocols, both clouds from one sample",
        "Both clouds of a pair hold the same points of the surface, which no two scans do: not to "
        "be quoted for separately sampled clouds.",
    ),
    "modelnet40-resampled": (
        "ModelNet40 protocols, each cloud sampled on its own",
        "The two clouds of a pair are separate samples: not to be compared with the sets whose "
        "clouds share one sample.",
    ),
    "cropped-apart": (
        "ModelNet40 protocols, each cloud cropped on its own",
        "Each cloud is cut by a plane of its own and then sampled: not to be compared with the "
        "sets whose clouds share one sample.",
    ),
    "mvp-rg": ("Two virtual scans", "The clouds are seen by two cameras, each with its sampling."),
    "stanford": ("Stanford range scans", ""),
    "mixture": ("Mixed pairs", ""),
}
_CROPPED_APART = ("geotransformer", "rpmnet", "predator")


def full_tables(sets: Sequence[SetResult]) -> list[Table]:
    """One table a family of sets with everything, and every row of the paper; sets as they come."""
    families: dict[str, list[SetResult]] = {}
    for result in sets:
        families.setdefault(family(result.name), []).append(result)
    return [_family_table(name, results) for name, results in families.items()]


def main_table(
    sets: Sequence[SetResult],
    *,
    methods: Mapping[str, str] | None = None,
    titles: Mapping[str, str] | None = None,
    title: str = "Results",
) -> Table:
    """The numbers that matter most, of all sets and groups, with GMCNet's best published row.

    `methods` and `titles` say how to call the methods and the sets.
    """
    rows: list[tuple[str, ...]] = []
    rules = set()
    last = {paper.protocol_of(result.name): result for result in sets}
    for result in sets:
        for block, found in _blocks(result, titles or {}):
            rules.add(len(rows))
            for method, one in found.items():
                name = (methods or {}).get(method, method)
                cells = [_cell(one, column, interval=False) for column in _MAIN_COLUMNS]
                rows.append((block, name, str(one.summary["n"]), *cells, _seconds(one)))
                block = ""
        protocol = paper.protocol_of(result.name)
        best = paper.best_row(protocol)
        if best is not None and result is last[protocol]:
            figures = best.figures[protocol]
            cells = [_published(figures, column) for column in _MAIN_COLUMNS]
            rows.append(("", paper.LABEL, NONE, *cells, NONE))
    header = ("pairs", "method", "n", *_MAIN_COLUMNS, "CPU s")
    remarks = [notes.seeds(sets), notes.told(sets), notes.unrelated(sets), notes.shapes_note(sets)]
    remarks = [remark for remark in remarks if remark]
    return Table(
        "main", title, plain_header(header), tuple(rows), tuple(remarks), 2, frozenset(rules)
    )


def family(name: str) -> str:
    """What a set is shown together with.

    >>> family("modelnet40/noisy/45"), family("modelnet40/noisy-resampled/180")
    ('modelnet40', 'modelnet40-resampled')
    """
    head = name.split("/")[0]
    if head in _CROPPED_APART:
        return "cropped-apart"
    return f"{head}-resampled" if re.search(r"-resampled(/|$)", name) else head


def _family_table(name: str, sets: Sequence[SetResult]) -> Table:
    published = any(paper.published_rows(paper.protocol_of(result.name)) for result in sets)
    # Where the shapes are others, the published rows stand beside ours, and nothing is subtracted.
    compared = any(paper.published_rows(paper.same_pairs(result.name)) for result in sets)
    differences = tuple(_DIFFERENCES) if compared else ()
    header = ("pairs", "method", "n", *_COLUMNS, "failures", "CPU s", *differences)
    rows: list[tuple[str, ...]] = []
    rules = set()
    last = {paper.protocol_of(result.name): result for result in sets}
    for result in sets:
        compared_with = paper.same_pairs(result.name)
        best = paper.best_row(compared_with)
        for block, found in _blocks(result, {}):
            rules.add(len(rows))
            for method, one in found.items():
                cells = [_cell(one, column, interval=True) for column in _COLUMNS]
                rest = [str(one.summary.get("errors", NONE)), _seconds(one)]
                rest += [_difference(one, best, compared_with, key) for key in differences]
                rows.append((block, method, str(one.summary["n"]), *cells, *rest))
                block = ""
        protocol = paper.protocol_of(result.name)
        for row in paper.published_rows(protocol) if result is last[protocol] else ():
            figures = row.figures[protocol]
            cells = [_published(figures, column) for column in _COLUMNS]
            mark = ", base of Δ" if row is best and compared else ""
            rest = [NONE] * (2 + len(differences))
            rows.append(("", f"paper: {row.label}{mark}", NONE, *cells, *rest))
    head = name.removesuffix("-resampled")
    title, about = _FAMILIES.get(name, (name if head == name else f"{head}, resampled", ""))
    remarks = [about, notes.seeds(sets), notes.shapes(sets), notes.told(sets), EXPLANATION]
    remarks.append(notes.unrelated(sets))
    if published:
        delta = " Δ: ours − GMCNet's best row in the paper's comparison of methods."
        remarks += [
            f"Rows “paper”: {paper.paper().citation}.{delta if compared else ''} The paper's "
            "analyses of its own method follow below its comparison of methods.",
            notes.marks(),
            notes.metrics_note(),
            notes.shapes_note(sets),
        ]
    label = re.sub(r"[^A-Za-z0-9-]", "-", name)
    remarks = [remark for remark in remarks if remark]
    return Table(
        label, title, plain_header(header), tuple(rows), tuple(remarks), 2, frozenset(rules)
    )


def _blocks(
    result: SetResult, titles: Mapping[str, str]
) -> Iterator[tuple[str, dict[str, MethodResult]]]:
    """The set, then its groups, each with what it is called; a title "" leaves it out."""
    name = titles.get(result.name, result.name)
    if name:
        yield name, result.methods
    for group, methods in result.groups.items():
        title = titles.get(group, f"{result.name}: {group}")
        if title:
            yield title, methods


def _cell(result: MethodResult, column: str, *, interval: bool) -> str:
    key, form = _COLUMNS[column]
    value = result.summary.get(key)
    if value is None:
        return NONE
    text = number(value, form)
    limits = result.summary.get(f"{key}_interval")
    if interval and limits is not None:
        text += f" [{number(limits[0], form)}, {number(limits[1], form)}]"
    return text


def _seconds(result: MethodResult) -> str:
    return NONE if result.cpu_seconds is None else f"{result.cpu_seconds:.2f}"


def _published(figures: Mapping[str, paper.Figure], column: str) -> str:
    return str(figures[_PAPER_COLUMNS[column]]) if column in _PAPER_COLUMNS else NONE


def _difference(result: MethodResult, best: paper.Row | None, name: str, key: str) -> str:
    column = _DIFFERENCES[key]
    value = result.summary.get(_COLUMNS[column][0])
    if best is None or value is None:
        return NONE
    return paper.difference(value, best.figures[name][_PAPER_COLUMNS[column]])
