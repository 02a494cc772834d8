"""What tables say below themselves: seeds, shapes, marks, and how far numbers can be compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fullturn.evaluation import paper
from fullturn.evaluation.folders import SetResult

_PUBLISHED_ON = {
    "modelnet40": "the test split of ModelNet40, all 40 categories or, unseen, the last 20, by "
    "networks trained on the training split",
    "mvp-rg": "the pairs of the MVP-RG dataset, by networks trained on it",
}


def seeds(sets: Sequence[SetResult]) -> str:
    """The seeds of the methods, and those of the pairs where the descriptions give them."""
    methods = {one.seed for result in sets for one in result.methods.values()}
    pairs = {result.description["seed"] for result in sets if "seed" in result.description}
    text = f"Seed of the methods: {', '.join(map(str, sorted(methods)))}"
    return f"{text}; of the pairs: {', '.join(map(str, sorted(pairs)))}." if pairs else f"{text}."


def shapes(sets: Sequence[SetResult]) -> str:
    """What the pairs were made from, where the descriptions say it."""
    here = " and ".join(dict.fromkeys(filter(None, map(made_from, sets))))
    return f"Shapes: {here}." if here else ""


def told(sets: Sequence[SetResult]) -> str:
    """Which methods were told how far the clouds can be turned, and how far that is."""
    known: dict[tuple[float, str], list[str]] = {}
    for result in sets:
        for method, one in result.methods.items():
            if one.told_rotation_deg is not None:
                known.setdefault((one.told_rotation_deg, result.name), []).append(method)
    where: dict[tuple[float, tuple[str, ...]], list[str]] = {}
    for (limit_deg, name), methods in known.items():
        where.setdefault((limit_deg, tuple(methods)), []).append(name)
    return " ".join(
        f"{' and '.join(methods)} {'was' if len(methods) == 1 else 'were'} told that rotations "
        f"are at most {limit_deg:.3g}° in {', '.join(names)}."
        for (limit_deg, methods), names in where.items()
    )


def unrelated(sets: Sequence[SetResult]) -> str:
    """That probabilities are judged on more pairs than errors are, where that is so."""
    if not any(one.summary.get("unrelated") for r in sets for one in r.methods.values()):
        return ""
    return (
        "Pairs of different objects have no right pose: errors and shares are over the other "
        "pairs, said and ECE over all, so said is lower than right there."
    )


def marks() -> str:
    return "; ".join(f"{mark}: {text}" for mark, text in paper.paper().marks.items()) + "."


def metrics_note() -> str:
    return (
        "What the paper prints as RMSE is a mean point distance in its released code, and stands "
        "beside ours of that name."
    )


def shapes_note(sets: Sequence[SetResult]) -> str:
    """What the published numbers were measured on, and what ours were."""
    compared = [r for r in sets if paper.best_row(paper.protocol_of(r.name)) is not None]
    if not compared:
        return ""
    data = dict.fromkeys(result.name.partition("/")[0] for result in compared)
    published = " and ".join(_PUBLISHED_ON[name] for name in data)
    here = " and ".join(dict.fromkeys(filter(None, map(made_from, compared)))) or "not stated"
    return (
        f"The published numbers are for {published}; the shapes here: {here}. They are a "
        "landmark, and a comparison only where the shapes are the same."
    )


def made_from(result: SetResult) -> str:
    """The shapes of a set in words, from its description; "" where it names none.

    >>> made_from(SetResult("a", {"shapes": {"kind": "mesh pack", "file": "m.npz"}}, 1))
    'mesh pack, m.npz'
    """
    sources = result.description.get("shapes")
    if isinstance(sources, Mapping):
        sources = [sources]
    return " and ".join(_words(one) for one in sources or () if isinstance(one, Mapping))


def _words(source: Mapping[str, Any]) -> str:
    parts = [str(source[key]) for key in ("kind", "file", "part") if source.get(key)]
    count = source.get("count")
    return ", ".join(parts + ([f"{count:,} shapes"] if isinstance(count, int) else []))
