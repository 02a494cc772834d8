"""The paper's numbers against its source, read by another parser than the file was made with."""

from __future__ import annotations

import os
import re
from collections import Counter
from pathlib import Path

import pytest

from fullturn.data.protocols import PROTOCOLS
from fullturn.evaluation import paper
from fullturn.evaluation.paper import Figure, best_row, difference, published_rows

M = "modelnet40/"
# Table → label in the source, and its settings from left to right.
SETTINGS = {
    "clean-and-unseen": (
        "tab:mn40_clean_and_unseen",
        (f"{M}clean/45", f"{M}clean/180", f"{M}clean/45/unseen", f"{M}clean/180/unseen"),
    ),
    "noisy-and-unseen": (
        "tab:mn40_noisy_and_unseen",
        (f"{M}noisy/45", f"{M}noisy/180", f"{M}noisy/45/unseen", f"{M}noisy/180/unseen"),
    ),
    "ablation": ("tab:ablation", (f"{M}clean/180",)),
    "mvp-rg": ("tab:mvp", ("mvp-rg",)),
}
# A number with what may stand around it; not the ends of rotation ranges, nor sizes of type.
NUMBER = r"(?:\\textless\s*)?\d+\.\d+|\bNC\b"


@pytest.fixture(scope="module")
def source() -> str:
    data = os.environ.get("FULLTURN_DATA")
    beside = Path(data).parent / "paper" / "gmcnet_ijcv.tex" if data else Path()
    path = Path(os.environ.get("FULLTURN_PAPER", beside))
    if not path.is_file():
        pytest.skip("the paper's source isn't there: set FULLTURN_PAPER to the .tex file")
    text = path.read_text(encoding="utf-8")
    return re.sub(r"\\(fontsize|setlength|toprule|midrule|cmidrule)\S*", " ", text)


def table_text(source: str, label: str) -> str:
    """From the first rule to the label: captions and headings of columns hold no numbers."""
    end = source.index(f"\\label{{{label}}}")
    return source[source.rindex("\\begin{tabular}", 0, end) : end]


def numbers(text: str) -> list[str]:
    """All numbers in order, as printed but for spaces, with the double dagger."""
    text = re.sub(r"\\[a-zA-Z]*(?:bf|it)\b", "", text)
    found = re.finditer(rf"({NUMBER})([^&]*?)(?=&|\\\\)", text)
    return [re.sub(r"\\textless\s*", "<", m[1]) + ("‡" if "ddag" in m[2] else "") for m in found]


def printed(row: paper.Row, protocols: tuple[str, ...]) -> list[str]:
    return [row.figures[p][m].text + row.figures[p][m].mark for p in protocols for m in paper.OURS]


@pytest.mark.parametrize("name", SETTINGS)
def test_every_number_of_a_table(source: str, name: str) -> None:
    label, protocols = SETTINGS[name]
    table = next(table for table in paper.paper().tables if table.name == name)
    assert table.protocols == protocols
    stored = [text for row in table.rows for text in printed(row, protocols)]
    assert stored == numbers(table_text(source, label))
    assert len(stored) == len(table.rows) * len(protocols) * 3


@pytest.mark.parametrize("name", ["clean-and-unseen", "noisy-and-unseen", "mvp-rg"])
def test_every_method_and_dagger(source: str, name: str) -> None:
    table = next(table for table in paper.paper().tables if table.name == name)
    text = table_text(source, SETTINGS[name][0]).replace("\\OM{}", "GMCNet")
    lines = [line for line in text.splitlines() if re.search(r"citep|GMCNet", line)]
    assert len(lines) == len(table.rows)
    for line, row in zip(lines, table.rows, strict=True):
        cell = line.split("&")[0]
        assert re.search(rf"\b{row.method}\b", cell)
        assert ("dag" in cell) == (row.marks == "†")
        inputs = re.search(r"\((?:\{|\\text(?:it)?\{)?(\w+)\}?\)", cell)
        assert (inputs[1] if inputs else "") == row.features


def test_every_number_of_the_input_analysis(source: str) -> None:
    table = next(table for table in paper.paper().tables if table.name == "input-features")
    text = table_text(source, "tab:feats")
    # Every input has two lines, one a range of rotation.
    expected = [
        text
        for row in table.rows
        for angle in (45, 180)
        for text in printed(
            row, (f"{M}clean/{angle}", f"{M}clean/{angle}/unseen", f"{M}noisy/{angle}")
        )
    ]
    assert expected == numbers(text)
    named = re.findall(r"(RRI|FPFH|PPF)\}?\s*(Only|\\\\)", text)
    assert [f"{n} only" if o == "Only" else f"{n} + XYZ + ΔXYZ" for n, o in named] == [
        row.features for row in table.rows
    ]


def test_the_line_that_the_text_alone_gives(source: str) -> None:
    (row,) = next(table for table in paper.paper().tables if table.name == "in-the-text").rows
    sentence = source[source.index("results of RANSAC(4M)") :][:200]
    assert re.findall(r"\d+\.\d+", sentence)[:3] == printed(row, (f"{M}clean/180",))


def test_the_source_is_named(source: str) -> None:
    title = re.search(r"\\title\{(.*?)[\\}\n]", source)
    assert title is not None
    assert title[1].strip() in paper.paper().citation
    assert "Liang Pan, Zhongang Cai, Ziwei Liu" in paper.paper().citation


def test_how_many_numbers_there_are() -> None:
    count = Counter(
        {
            table.name: sum(len(part) for row in table.rows for part in row.figures.values())
            for table in paper.paper().tables
        }
    )
    assert count == {
        "clean-and-unseen": 144, "noisy-and-unseen": 144, "input-features": 108, "ablation": 12,
        "in-the-text": 3, "mvp-rg": 24,
    }  # fmt: skip


def test_its_settings_are_protocols_of_ours() -> None:
    named = {p for table in paper.paper().tables for p in table.protocols}
    assert named <= set(PROTOCOLS)
    assert len(named) == 9


def test_best_rows() -> None:
    best = {p: best_row(p) for p in PROTOCOLS}
    assert {p for p, row in best.items() if row is not None} == {
        p for table in paper.paper().tables for p in table.protocols
    }
    for protocol, row in best.items():
        if row is not None:
            others = [r.figures[protocol]["rotation_error_deg"] for r in published_rows(protocol)]
            value = row.figures[protocol]["rotation_error_deg"].value
            assert row.method == paper.METHOD
            assert value in [figure.value for figure in others]


def test_a_row_stands_once() -> None:
    labels = [row.label for row in published_rows(f"{M}clean/180")]
    assert len(labels) == len(set(labels)) == 12 + 3 + 4 + 1
    assert published_rows("geotransformer/180") == []


@pytest.mark.parametrize(
    ("text", "value", "bound"),
    [("18.13", 18.13, False), ("<0.0001", 0.0001, True), ("NC", None, False)],
)
def test_figures(text: str, value: float | None, bound: bool) -> None:
    assert (Figure(text).value, Figure(text).is_bound) == (value, bound)


def test_differences_keep_the_printed_decimals_and_the_bounds() -> None:
    assert difference(0.2, Figure("18.13")) == "−17.93"
    assert difference(20.0, Figure("18.13")) == "+1.87"
    assert difference(0.0011, Figure("<0.0001")) == "> +0.0010"
    assert difference(0.0, Figure("<0.0001")) == "> −0.0001"
    assert difference(1.0, Figure("NC")) == "–"
