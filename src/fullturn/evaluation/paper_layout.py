"""The paper's comparisons in its own layout, with our methods below."""

from __future__ import annotations

from collections.abc import Sequence

from fullturn.evaluation import notes, paper
from fullturn.evaluation.folders import MethodResult, SetResult
from fullturn.evaluation.layout import NONE, Table, number

_SYMBOLS = {"rotation_error_deg": "R, °", "translation_error": "t", "l_rmse": "RMSE"}


def paper_layout(sets: Sequence[SetResult]) -> list[Table]:
    """The paper's comparisons in its own layout, our methods below the paper's.

    Only those of which at least one setting was run.
    """
    by_name = {result.name: result for result in sets}
    tables = []
    for published in paper.paper().tables:
        protocols = published.protocols
        run = [by_name[name] for name in protocols if name in by_name]
        if published.kind != "comparison" or not run:
            continue
        rows: list[tuple[str, ...]] = [
            (row.label, *(str(row.figures[p][m]) for p in protocols for m in paper.OURS))
            for row in published.rows
        ]
        first = len(rows)
        for method in dict.fromkeys(method for result in run for method in result.methods):
            found = [by_name[p].methods.get(method) if p in by_name else None for p in protocols]
            rows.append((method, *(_ours(one, metric) for one in found for metric in paper.OURS)))
        header: list[tuple[str, ...]] = [("", "", "method")]
        header += [(*_setting(p), _SYMBOLS[m]) for p in protocols for m in paper.OURS]
        remarks = [f"Rows of the paper: {paper.paper().citation}.", notes.marks()]
        remarks += [notes.metrics_note(), notes.seeds(run), notes.told(run)]
        remarks.append(notes.shapes_note(run))
        tables.append(
            Table(
                f"paper-{published.name}",
                f"{published.title}, in the paper's layout",
                tuple(header),
                tuple(rows),
                tuple(filter(None, remarks)),
                rules=frozenset({first}),
            )
        )
    return tables


def _ours(result: MethodResult | None, metric: str) -> str:
    value = None if result is None else result.summary.get(paper.OURS[metric])
    if value is None:
        return NONE
    return number(value, "°" if metric == "rotation_error_deg" else 4)


def _setting(protocol: str) -> tuple[str, str]:
    """The two upper headings of a protocol in the paper's layout.

    >>> _setting("modelnet40/noisy/45/unseen"), _setting("mvp-rg")
    (('noisy, unseen', '[0, 45°]'), ('mvp-rg', '[0, 180°]'))
    """
    parts = protocol.split("/")
    if len(parts) < 3:
        return protocol, "[0, 180°]"
    return ", ".join([parts[1], *parts[3:]]), f"[0, {parts[2]}°]"
