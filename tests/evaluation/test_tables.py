"""Tables from run folders: what stands in them, what is refused, what each format escapes."""

from __future__ import annotations

import html.parser
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from run_folders import set_part, summary, write_run

from fullturn.errors import FullturnError, InputError, ReadError
from fullturn.evaluation import metrics, paper
from fullturn.evaluation.folders import SetResult, read_pairs, read_runs
from fullturn.evaluation.layout import Table, html_section, latex, latex_text, markdown
from fullturn.evaluation.notes import made_from
from fullturn.evaluation.paper_layout import paper_layout
from fullturn.evaluation.tables import full_tables, main_table

CLEAN, NOISY = "modelnet40/clean/180", "modelnet40/noisy/180"
RESAMPLED = "modelnet40/noisy-resampled/180"


def run(folder: Path, *names: str, methods: tuple[str, ...] = ("ours",), **options: int) -> Path:
    return write_run(
        folder, {n: set_part({m: summary() for m in methods}) for n in names}, **options
    )


def cells(table: Table, method: str) -> dict[str, str]:
    """The first row of a method, by heading."""
    row = next(row for row in table.rows if row[1] == method)
    return dict(zip([levels[-1] for levels in table.header], row, strict=True))


def test_every_column_has_its_number(tmp_path: Path) -> None:
    (table,) = full_tables(read_runs([run(tmp_path / "a", "scans")]))
    assert cells(table, "ours") == {
        "pairs": "scans", "method": "ours", "n": "4", "mean °": "2.50 [1.25, 4.50]",
        "median °": "0.500", "<1° %": "50.0", "<5° %": "75.0 [25.0, 100.0]", "right %": "75.0",
        "geometric %": "100.0 [100.0, 100.0]", "said %": "62.5", "ECE": "0.087",
        "sure %": "–", "sure, right %": "–",
        "mean t": "0.0123", "mean distance": "0.0456", "failures": "1", "CPU s": "0.38",
    }  # fmt: skip
    assert "Seed of the methods: 5; of the pairs: 3." in table.notes


def test_what_is_missing_is_a_dash(tmp_path: Path) -> None:
    # Of unrelated pairs alone, no error is defined.
    unrelated = {"n": 4, "unrelated": 4, "errors": 0, "mean_probability": 0.1}
    mixed = summary(states=False, unrelated=4, n=8)
    part = set_part({"ours": mixed}, groups={"unrelated": {"ours": unrelated}})
    (table,) = full_tables(read_runs([write_run(tmp_path / "a", {"mixture": part}, timing=False)]))
    row = cells(table, "ours")
    assert row["said %"] == row["ECE"] == row["CPU s"] == "–"
    assert any("different objects" in note for note in table.notes)
    group = table.rows[1]
    assert group[0] == "mixture: unrelated"
    assert set(group[3:]) == {"–", "10.0", "0"}
    assert table.rules == {0, 1}


def test_methods_of_two_runs_stand_beside_one_another(tmp_path: Path) -> None:
    first = run(tmp_path / "a", CLEAN, NOISY, methods=("one", "two"))
    second = run(tmp_path / "b", NOISY, methods=("three",), seed=6)
    sets = read_runs([first, second])
    assert [(s.name, list(s.methods)) for s in sets] == [
        (CLEAN, ["one", "two"]),
        (NOISY, ["one", "two", "three"]),
    ]
    assert "Seed of the methods: 5, 6; of the pairs: 3." in full_tables(sets)[0].notes


def test_the_paper_stands_below_with_differences(tmp_path: Path) -> None:
    sets = read_runs([run(tmp_path / "a", NOISY, "modelnet40/clean/45", RESAMPLED)])
    same, separate = full_tables(sets)
    row = cells(same, "ours")
    assert row["Δ °"] == "−15.63"
    assert row["Δ t"] == "−0.081"
    methods = [row[1] for row in same.rows]
    assert "paper: GMCNet (PPF), base of Δ" in methods
    assert "paper: IDAM† (GNN)" in methods
    for protocol in (NOISY, "modelnet40/clean/45"):
        for published in paper.published_rows(protocol):
            assert any(method.startswith(f"paper: {published.label}") for method in methods)
    bound = next(row for row in same.rows if row[0] == "modelnet40/clean/45")
    assert bound[-2] == "> +0.0122"
    assert any("part of ModelNet40, shapes.npz, test, 9 shapes" in note for note in same.notes)
    # Separately sampled clouds are a table of their own, without the paper's numbers.
    assert not any(row[1].startswith("paper") for row in separate.rows)
    assert "Δ °" not in [levels[-1] for levels in separate.header]
    assert any("not to be compared" in note for note in separate.notes)


def test_the_main_table_has_the_best_published_row(tmp_path: Path) -> None:
    sets = read_runs([run(tmp_path / "a", CLEAN, RESAMPLED)])
    table = main_table(sets, methods={"ours": "Ours"}, titles={CLEAN: "clean", RESAMPLED: ""})
    assert [row[:4] for row in table.rows] == [
        ("clean", "Ours", "4", "2.50"),
        ("", paper.LABEL, "–", "0.036"),
    ]


def test_a_set_like_the_papers_has_its_rows_once_and_no_difference(tmp_path: Path) -> None:
    sets = read_runs([run(tmp_path / "a", "mvp-rg/built", "mvp-rg/built/blind")])
    (table,) = full_tables(sets)
    assert table.header[-1] == ("CPU s",)
    published = [row[1] for row in table.rows if row[1].startswith("paper: ")]
    assert len(published) == len(paper.published_rows("mvp-rg")) > 3
    assert [row[1] for row in table.rows[:2]] == ["ours", "ours"]
    assert not any("base of Δ" in name for name in published)
    assert any("pairs of the MVP-RG dataset" in note for note in table.notes)
    main = main_table(sets)
    assert [row[1] for row in main.rows] == ["ours", "ours", "GMCNet, as published"]


def limited_run(folder: Path, limits_deg: dict[str, float | None], *takers: str) -> Path:
    """Of the methods "ours" and "icp", the takers take the largest rotation."""
    sets = {name: set_part({"ours": summary(), "icp": summary()}) for name in limits_deg}
    for name, limit_deg in limits_deg.items():
        if limit_deg is not None:
            sets[name]["description"]["told_rotation_deg"] = limit_deg
    path = write_run(folder, sets) / "summary.json"
    content = json.loads(path.read_text())
    for method, described in content["methods"].items():
        described["traits"] = {"limits_rotation": method in takers}
    path.write_text(json.dumps(content))
    return folder


def test_who_was_told_how_far_clouds_are_turned_is_noted(tmp_path: Path) -> None:
    small, blind = "modelnet40/noisy/45", "modelnet40/noisy/45/blind"
    limits = {small: 45.0, "modelnet40/clean/45": 45.0, blind: None, NOISY: None}
    sets = read_runs([limited_run(tmp_path / "a", limits, "ours")])
    told = f"ours was told that rotations are at most 45° in {small}, modelnet40/clean/45."
    for table in (*full_tables(sets), main_table(sets)):
        assert told in table.notes
    assert any("told that" in note for note in paper_layout(sets)[0].notes)
    limits = {"rpmnet/45": 85.802, "geotransformer/180": None}
    (table,) = full_tables(read_runs([limited_run(tmp_path / "b", limits, "ours", "icp")]))
    assert "ours and icp were told that rotations are at most 85.8° in rpmnet/45." in table.notes
    untold = read_runs([limited_run(tmp_path / "c", limits)])
    assert not any("told that" in note for note in main_table(untold).notes)


def test_blind_pairs_stand_beside_the_paper_as_the_others_do(tmp_path: Path) -> None:
    sets = read_runs([run(tmp_path / "a", NOISY, f"{NOISY}/blind")])
    (table,) = full_tables(sets)
    ours = [row for row in table.rows if row[1] == "ours"]
    assert [row[-3:] for row in ours] == [ours[0][-3:]] * 2
    assert ours[0][-3] == "−15.63"
    published = [row[1] for row in table.rows if row[1].startswith("paper: ")]
    assert len(published) == len(paper.published_rows(NOISY))
    assert "paper: GMCNet (PPF), base of Δ" in published


def test_runs_on_the_same_pairs_may_differ_in_what_they_tell(tmp_path: Path) -> None:
    name = "modelnet40/noisy/45"
    before = run(tmp_path / "a", name, methods=("before",))
    (found,) = read_runs([before, limited_run(tmp_path / "b", {name: 45.0}, "ours")])
    told = {method: one.told_rotation_deg for method, one in found.methods.items()}
    assert told == {"before": None, "ours": 45.0, "icp": None}


def frozen_run(folder: Path, method: str, **frozen: str) -> Path:
    part = set_part({method: summary()})
    part["description"] |= {"frozen": frozen} if frozen else {}
    return write_run(folder, {"frozen/pairs": part})


def test_copies_of_a_frozen_file_are_the_same_pairs(tmp_path: Path) -> None:
    first = frozen_run(tmp_path / "a", "ours", sha256="1", file="a.npz")
    copied = frozen_run(tmp_path / "b", "icp", sha256="1", file="copy.npz")
    (found,) = read_runs([first, copied])
    assert set(found.methods) == {"ours", "icp"}
    for number, other in enumerate(({"sha256": "2", "file": "a.npz"}, {})):
        with pytest.raises(InputError, match="in: frozen"):
            read_runs([first, frozen_run(tmp_path / f"c{number}", "icp", **other)])


def test_the_layout_of_the_paper(tmp_path: Path) -> None:
    sets = read_runs([run(tmp_path / "a", NOISY, RESAMPLED, "mvp-rg")])
    noisy, views = paper_layout(sets)
    assert len(noisy.header) == 1 + 4 * 2 * 3 // 2
    assert noisy.header[4] == ("noisy", "[0, 180°]", "R, °")
    assert [row[0] for row in noisy.rows][-4:] == [
        "GMCNet (RRI)", "GMCNet (FPFH)", "GMCNet (PPF)", "ours",
    ]  # fmt: skip
    ours, gmcnet = noisy.rows[-1], noisy.rows[-2]
    assert ours[1:7] == ("–", "–", "–", "2.50", "0.0123", "0.0456")
    assert gmcnet[4:7] == ("18.13", "0.093", "0.132")
    assert noisy.rules == {12}
    assert "NC" in noisy.rows[0]
    assert any("MVP-RG dataset" in note for note in views.notes)


def test_shapes_of_several_places() -> None:
    packs = [{"kind": "mesh pack", "file": f"{name}.npz"} for name in "ab"]
    sets = SetResult("x", {"shapes": packs}, 1)
    assert made_from(sets) == "mesh pack, a.npz and mesh pack, b.npz"


def test_shapes_without_a_description() -> None:
    from fullturn.evaluation.folders import SetResult

    assert made_from(SetResult("a", {}, 1)) == ""


class TestRefusals:
    def refused(self, *folders: Path) -> str:
        with pytest.raises(FullturnError) as caught:
            read_runs(folders)
        message = str(caught.value)
        assert "expected" in message
        assert ";" in message
        return message

    def test_no_folder(self) -> None:
        assert "at least one" in self.refused()

    def test_no_summary(self, tmp_path: Path) -> None:
        assert "summary.json" in self.refused(tmp_path)
        assert "summary.json" in self.refused(tmp_path / "nowhere")

    @pytest.mark.parametrize("format_", [0, 2, None, "1"])
    def test_another_format(self, tmp_path: Path, format_: object) -> None:
        path = run(tmp_path / "a", CLEAN) / "summary.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | {"format": format_}))
        assert "expected format 1" in self.refused(tmp_path / "a")

    @pytest.mark.parametrize("name", ["summary.json", "timing.json"])
    @pytest.mark.parametrize("damage", ["cut", "list", "bytes"])
    def test_damaged_json(self, tmp_path: Path, name: str, damage: str) -> None:
        path = run(tmp_path / "a", CLEAN) / name
        content = {"cut": path.read_bytes()[:-9], "list": b"[]", "bytes": b"\xff\xfe"}[damage]
        path.write_bytes(content)
        assert name in self.refused(tmp_path / "a")

    @pytest.mark.parametrize(
        "change",
        [
            lambda c: c.pop("seed"),
            lambda c: c.pop("sets"),
            lambda c: c["sets"][CLEAN].pop("count"),
            lambda c: c["sets"][CLEAN].update(description="x"),
            lambda c: c["sets"][CLEAN].update(methods=[]),
            lambda c: c["sets"][CLEAN]["methods"]["ours"].pop("n"),
            lambda c: c["sets"][CLEAN].update(groups={"g": 3}),
        ],
    )
    def test_missing_parts(self, tmp_path: Path, change: object) -> None:
        path = run(tmp_path / "a", CLEAN) / "summary.json"
        content = json.loads(path.read_text())
        change(content)  # type: ignore[operator]
        path.write_text(json.dumps(content))
        assert "missing" in self.refused(tmp_path / "a")

    @pytest.mark.parametrize("sets", [None, [], {CLEAN: 3}, {CLEAN: {"ours": 3}}])
    def test_times_of_another_kind(self, tmp_path: Path, sets: object) -> None:
        folder = run(tmp_path / "a", CLEAN)
        (folder / "timing.json").write_text(json.dumps({"sets": sets}))
        assert "timing.json" in self.refused(folder)

    def test_other_pairs(self, tmp_path: Path) -> None:
        first = run(tmp_path / "a", CLEAN, NOISY)
        part = set_part({"other": summary()})
        part["description"] = part["description"] | {"seed": 4}
        message = self.refused(first, write_run(tmp_path / "b", {NOISY: part}))
        assert NOISY in message
        assert message.split("differs")[1].split(";")[0].endswith("in: seed")

    def test_another_count(self, tmp_path: Path) -> None:
        part = set_part({"other": summary()}) | {"count": 3}
        second = write_run(tmp_path / "b", {CLEAN: part})
        assert "count of pairs" in self.refused(run(tmp_path / "a", CLEAN), second)

    def test_a_method_twice(self, tmp_path: Path) -> None:
        folders = [run(tmp_path / name, CLEAN) for name in "ab"]
        assert "got ours from" in self.refused(*folders)


class TestPairs:
    def test_rows(self, tmp_path: Path) -> None:
        (found,) = read_runs([run(tmp_path / "a", CLEAN, methods=("one", "two"))])
        rows = read_pairs(found, "two")
        assert rows is not None
        # The last one failed: no error is small enough for it, and it said nothing.
        np.testing.assert_allclose(rows.rotation_error_deg, [0.4, 1.6, 6.4, np.inf])
        assert rows.success.tolist() == [True, True, False, False]
        assert rows.probability is not None
        np.testing.assert_allclose(rows.probability, [0.95, 0.75, 0.55, 0.0])

    def test_unrelated_pairs_have_no_error(self, tmp_path: Path) -> None:
        folder = run(tmp_path / "a", "mixture")
        path = folder / "pairs" / "mixture.csv"
        path.write_text(re.sub(r"^(ours,0,,,)1,[\d.]+", r"\g<1>0,", path.read_text(), flags=re.M))
        rows = read_pairs(read_runs([folder])[0], "ours")
        assert rows is not None
        assert (len(rows.rotation_error_deg), len(rows.success)) == (3, 4)

    def test_without_the_file_there_are_none(self, tmp_path: Path) -> None:
        folder = run(tmp_path / "a", CLEAN)
        (folder / "pairs" / "modelnet40-clean-180.csv").unlink()
        assert read_pairs(read_runs([folder])[0], "ours") is None

    @pytest.mark.parametrize("change", [lambda t: t.replace("method", "x"), lambda t: t[:-30]])
    def test_damaged(self, tmp_path: Path, change: object) -> None:
        folder = run(tmp_path / "a", CLEAN)
        path = folder / "pairs" / "modelnet40-clean-180.csv"
        path.write_text(change(path.read_text().replace("0.95", "0.9x5")))  # type: ignore[operator]
        with pytest.raises(ReadError, match="run the evaluation again"):
            read_pairs(read_runs([folder])[0], "ours")

    def test_a_row_too_few(self, tmp_path: Path) -> None:
        folder = run(tmp_path / "a", CLEAN)
        path = folder / "pairs" / "modelnet40-clean-180.csv"
        path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
        with pytest.raises(ReadError, match="expected 4 pairs of ours"):
            read_pairs(read_runs([folder])[0], "ours")


def test_reliability_adds_up() -> None:
    rng = np.random.default_rng(0)
    probability = np.concatenate([rng.uniform(size=500), [0.0, 1.0]])
    success = rng.uniform(size=502) < probability
    said, right, pairs = metrics.reliability(probability, success)
    assert pairs.sum() == 502
    assert np.dot(said, pairs) == pytest.approx(probability.sum())
    assert np.dot(right, pairs) == pytest.approx(success.sum())


ODD = "a|b & c_d < 50 % {x} \\y $z #1 ~ ^ <b>"


@pytest.fixture
def odd() -> Table:
    header = (("", "one"), ("top", "two"), ("top", "three"))
    return Table(
        "odd", ODD, header, ((ODD, "[1]", "2"), ("", "–", "−3°")), (ODD,), rules=frozenset({1})
    )


class TestFormats:
    def test_markdown_keeps_its_columns(self, odd: Table) -> None:
        lines = markdown(odd).splitlines()
        assert len(lines) == 4
        assert {len(re.findall(r"(?<!\\)\|", line)) for line in lines} == {4}
        assert lines[0] == "| one | top, two | top, three |"

    def test_latex_keeps_its_columns(self, odd: Table) -> None:
        text = latex(odd)
        rows = [line for line in text.splitlines() if line.endswith(" \\\\")]
        assert len(rows) == 4
        assert "\\multicolumn{2}{c}{top}" in rows[0]
        assert "\\cmidrule(lr){2-3}" in text
        assert {len(re.findall(r"(?<!\\)&", row)) for row in rows[1:]} == {2}
        assert text.count("\\midrule") == 2
        assert text.count("{") - text.count("\\{") == text.count("}") - text.count("\\}")

    @pytest.mark.parametrize("letter", list("&%#_{}"))
    def test_latex_escapes(self, letter: str) -> None:
        assert latex_text(f"a{letter}b") == f"a\\{letter}b"
        assert latex_text("\\") == r"\textbackslash{}"

    def test_latex_is_plain_where_it_must_be(self, tmp_path: Path) -> None:
        sets = read_runs([run(tmp_path / "a", NOISY, RESAMPLED, "mvp-rg", "scans")])
        for table in (main_table(sets), *full_tables(sets), *paper_layout(sets)):
            # What pdflatex reads without further packages: ASCII, and these typographic signs.
            assert set(latex(table)) - set("“”") <= {chr(code) for code in range(128)}

    def test_html_is_well_formed(self, odd: Table) -> None:
        class Reader(html.parser.HTMLParser):
            stack: list[str]
            text = ""

            def handle_starttag(self, tag: str, attrs: object) -> None:
                self.stack.append(tag)

            def handle_endtag(self, tag: str) -> None:
                assert self.stack.pop() == tag

            def handle_data(self, data: str) -> None:
                self.text += data

        reader = Reader()
        reader.stack = []
        reader.feed(html_section(odd))
        assert reader.stack == []
        assert reader.text.count(ODD) == 3


def test_input_errors_are_input_errors() -> None:
    with pytest.raises(InputError):
        read_runs([])
