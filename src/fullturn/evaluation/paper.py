"""The numbers of the GMCNet paper, as printed: L. Pan, Z. Cai, Z. Liu, "Robust Partial-to-Partial
Point Cloud Registration in a Full Range", International Journal of Computer Vision.

They stand in `paper.json`: five tables, and one line that the text alone gives. What a figure is
compared with is `OURS`; the column printed as L_RMSE is a mean point distance in the released code,
whatever the formula in the text says, so it stands beside ours of that name.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources

from fullturn.data.hidden import BLIND

# The paper's columns → the keys of our summaries.
OURS = {
    "rotation_error_deg": "mean_deg",
    "translation_error": "mean_translation_error",
    "l_rmse": "mean_mean_point_distance",
}
METHOD = "GMCNet"
LABEL = "GMCNet, as published"


@dataclass(frozen=True)
class Figure:
    """One number as printed: a value, the upper bound of one, or "did not converge"."""

    text: str  # without marks: "0.036", "<0.0001", "NC"
    mark: str = ""  # "‡": see `Paper.marks`

    def __str__(self) -> str:
        return self.text + self.mark

    @property
    def value(self) -> float | None:
        """The number, or the bound; None where the training did not converge."""
        return None if self.text == "NC" else float(self.text.removeprefix("<"))

    @property
    def is_bound(self) -> bool:
        """Whether the true number is only known to be smaller."""
        return self.text.startswith("<")


@dataclass(frozen=True)
class Row:
    """What one method reached, by our names of the protocols and the metrics of `OURS`."""

    method: str
    features: str  # its input, "" where the paper names none
    marks: str  # "†": see `Paper.marks`
    figures: Mapping[str, Mapping[str, Figure]]

    @property
    def label(self) -> str:
        """Method, mark and input.

        >>> Row("IDAM", "FPFH", "†", {}).label
        'IDAM† (FPFH)'
        """
        return f"{self.method}{self.marks}" + (f" ({self.features})" if self.features else "")


@dataclass(frozen=True)
class PaperTable:
    """One table: a comparison of methods, or an analysis of the paper's own."""

    name: str
    title: str
    kind: str  # "comparison" or "analysis"
    rows: tuple[Row, ...]

    @property
    def protocols(self) -> tuple[str, ...]:
        """Our names of its settings, from left to right."""
        return tuple(dict.fromkeys(name for row in self.rows for name in row.figures))


@dataclass(frozen=True)
class Paper:
    """The figures and where they are from."""

    citation: str
    marks: Mapping[str, str]  # what †, ‡ and NC mean
    tables: tuple[PaperTable, ...]


@functools.cache
def paper() -> Paper:
    """Everything that `paper.json` holds."""
    path = resources.files("fullturn.evaluation") / "paper.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    source, metrics = content["source"], content["metrics"]
    tables = tuple(
        PaperTable(
            table["name"],
            table["title"],
            table["kind"],
            tuple(
                Row(
                    row["method"],
                    row["features"],
                    row["marks"],
                    {
                        protocol: dict(zip(metrics, map(_figure, texts), strict=True))
                        for protocol, texts in row["values"].items()
                    },
                )
                for row in table["rows"]
            ),
        )
        for table in content["tables"]
    )
    citation = f"{', '.join(source['authors'])}: {source['title']}. {source['journal']}"
    return Paper(citation, content["marks"], tables)


def protocol_of(name: str) -> str:
    """The paper's setting that a set of pairs is like.

    >>> protocol_of("mvp-rg/built/blind"), protocol_of("modelnet40/clean/45/blind")
    ('mvp-rg', 'modelnet40/clean/45')
    """
    name = same_pairs(name)
    return "mvp-rg" if name.startswith("mvp-rg/") else name


def same_pairs(name: str) -> str:
    """What a set of these pairs is called where all that is known of them is told.

    >>> same_pairs("mvp-rg/built/blind"), same_pairs("modelnet40/clean/45")
    ('mvp-rg/built', 'modelnet40/clean/45')
    """
    return name.removesuffix(BLIND)


def published_rows(protocol: str) -> list[Row]:
    """Every row that the paper has for a protocol, each set of figures once.

    The comparisons come first; an analysis repeats some of their rows.
    """
    rows: list[Row] = []
    for table in sorted(paper().tables, key=lambda table: table.kind != "comparison"):
        for row in table.rows:
            figures = row.figures.get(protocol)
            known = [other.figures[protocol] for other in rows if other.method == row.method]
            if figures is not None and figures not in known:
                rows.append(row)
    return rows


def best_row(protocol: str) -> Row | None:
    """The paper's own method with the least rotation error in its comparison of methods.

    None where the paper has no such protocol. Its analysis of input features has a lower one for
    "modelnet40/clean/180" and "modelnet40/clean/180/unseen", with RRI alone as input.

    >>> best_row("modelnet40/noisy/180").label
    'GMCNet (PPF)'
    """
    candidates = [
        (value, row)
        for table in paper().tables
        for row in table.rows
        if table.kind == "comparison" and row.method == METHOD and protocol in row.figures
        if (value := row.figures[protocol]["rotation_error_deg"].value) is not None
    ]
    return min(candidates, key=lambda item: item[0])[1] if candidates else None


def difference(ours: float, published: Figure) -> str:
    """Ours − published, signed, with the decimals as printed; "–" where there is none to subtract.

    From a bound only a lower end follows: ours − (less than b) is more than ours − b.

    >>> difference(0.223, Figure("18.13")), difference(0.5, Figure("<0.1"))
    ('−17.91', '> +0.4')
    """
    if published.value is None:
        return "–"
    decimals = len(published.text.partition(".")[2])
    text = f"{ours - published.value:+.{decimals}f}".replace("-", "−")
    return f"> {text}" if published.is_bound else text


def _figure(text: str) -> Figure:
    return Figure(text.removesuffix("‡"), "‡" if text.endswith("‡") else "")
