"""The report is one valid page, complete in itself, whatever the names and the numbers."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from importlib import resources

import numpy as np
import pytest

from fullturn.errors import InputError, WriteError
from fullturn.viz import tables
from fullturn.viz.report import render_report, write_report

VOID = {"meta", "link", "br", "img", "input", "hr"}


class Page(HTMLParser):
    """Parses strictly: every element that is opened is closed, in order."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.ids: dict[str, str] = {}
        self.attributes: list[tuple[str, str, str]] = []
        self.texts: dict[str, str] = {}
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        for name, value in attrs:
            self.attributes.append((tag, name, value or ""))
            if name == "id":
                assert value not in self.ids, f"two elements with id {value}"
                self.ids[value] = tag
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data):
        place = self.open[-1] if self.open else ""
        self.texts[place] = self.texts.get(place, "") + data


def scene_of(text: str) -> dict:
    found = re.search(r'<script type="application/json" id="scene">(.*?)</script>', text, re.S)
    return json.loads(found.group(1))


def test_the_page_parses_for_any_cloud(make_pair, shape):
    page = Page(render_report(*make_pair(shape)))
    assert {"canvas", "scene", "matrix", "views", "colors", "copy"} <= set(page.ids)


def test_nothing_is_loaded_from_anywhere(make_pair):
    text = render_report(*make_pair())
    assert "://" not in text
    assert "@import" not in text
    assert not re.search(r"url\s*\(", text)
    page = Page(text)
    addresses = [v for _, name, v in page.attributes if name in {"src", "href", "srcset", "action"}]
    assert addresses == ["data:,"]
    policy = next(v for _, name, v in page.attributes if name == "content" and "default-src" in v)
    assert policy.startswith("default-src 'none'")


@pytest.mark.parametrize(
    "name",
    [
        "</title><script>alert(1)</script>",
        '"><img src=x onerror=alert(1)>',
        "a & b's \u202egnp.\x00\n.ply",
        "\udcff bad bytes",
        "$source_name ${matrix} \\1",
        "Büste – 彫刻.ply",
    ],
)
def test_odd_names_stay_text(make_pair, tmp_path, name):
    source, target, result = make_pair()
    result = replace(result, notes=(name,), method=name, seconds={name: 0.1, "total": 0.1})
    result = replace(result, symmetry=replace(result.symmetry, description=name))
    path = tmp_path / "report.html"
    write_report(path, source, target, result, source_name=name, target_name=name)
    page = Page(path.read_text(encoding="utf-8"))
    plain = "".join(c if c.isprintable() else "\ufffd" for c in name)
    assert plain in page.texts["title"]
    assert plain in page.texts["li"]
    assert not any(
        tag == "img" or attribute.startswith("on") for tag, attribute, _ in page.attributes
    )
    assert len(re.findall("<script", path.read_text(encoding="utf-8"))) == 2


def test_the_matrix_can_be_copied_and_read_back(make_pair, shape):
    source, target, result = make_pair(shape)
    text = Page(render_report(source, target, result)).texts["pre"]
    found = np.array([[float(x) for x in line.split()] for line in text.strip().splitlines()])
    np.testing.assert_allclose(found, result.T_target_source, rtol=1e-11, atol=1e-15)


def test_every_view_has_its_button(make_pair):
    text = render_report(*make_pair(alternatives=9))
    names = [view["name"] for view in scene_of(text)["views"]]
    assert names == ["Before", "After", "Matches"] + [f"Alternative {k}" for k in range(1, 7)]
    buttons = re.findall(r"""data-view=["'](\d+)["']""", text)
    assert sorted({int(b) for b in buttons}) == list(range(len(names)))
    assert text.count("<tr><th scope='row'>9</th>") == 1  # the table has all nine


def test_the_numbers_are_there(make_pair):
    source, target, result = make_pair()
    text = render_report(source, target, result)
    angle, _ = tables.angle_axis(result.T_target_source)
    sd_deg = np.rad2deg(0.01)
    for expected in (">0.80<", f"{angle:.3f}°", "75.0 %", "80.0 %", f"{sd_deg:.3g}", "0.001"):
        assert expected in text
    for expected in ("2-fold rotation", "dropped 3 points", "describe", "consensus", "0.95"):
        assert expected in text


def test_what_is_not_known_is_said(make_pair):
    source, target, result = make_pair(alternatives=0, matches=0)
    result = replace(
        result,
        symmetry=None,
        notes=(),
        seconds={},
        covariance=np.full((6, 6), np.nan),
        success_probability=float("nan"),
    )
    text = render_report(source, target, result)
    Page(text)
    assert text.count("not known") == 7
    assert "none found" in text


def test_a_large_pair_stays_below_two_megabytes(make_pair):
    text = render_report(*make_pair(count=120_000, alternatives=9, matches=50_000))
    assert len(text.encode()) < 2_000_000
    assert "Drawn: 30,000 + 30,000 of 120,000 + 96,000 points" in text


def test_the_same_input_gives_the_same_page(make_pair):
    assert render_report(*make_pair()) == render_report(*make_pair())


def test_a_failed_write_leaves_what_was_there(make_pair, tmp_path):
    path = tmp_path / "report.html"
    path.write_text("before")
    source, target, result = make_pair()
    with pytest.raises(InputError):
        write_report(path, np.zeros((3, 2)), target, result)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    assert path.read_text() == "before"
    with pytest.raises(WriteError):
        write_report(tmp_path / "missing" / "report.html", source, target, result)


def test_the_script_is_valid(tmp_path):
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    script = resources.files("fullturn.viz") / "assets" / "viewer.js"
    path = tmp_path / "viewer.js"
    path.write_text(script.read_text(encoding="utf-8"), encoding="utf-8")
    done = subprocess.run([node, "--check", str(path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_script_and_the_page_name_the_same_elements():
    assets = resources.files("fullturn.viz") / "assets"
    script = (assets / "viewer.js").read_text(encoding="utf-8")
    page = "".join((assets / n).read_text(encoding="utf-8") for n in ("page.html", "report.html"))
    style = (assets / "report.css").read_text(encoding="utf-8")
    for name in re.findall(r'getElementById\("([\w-]+)"\)', script):
        assert name == "scene" or f'id="{name}"' in page  # the frame adds the scene
    for color in re.findall(r'color\("(\w+)"\)', script):
        assert len(re.findall(rf"--{color}: #[0-9a-f]{{6}};", style)) == 2


def test_examples_in_the_docstrings():
    import doctest

    from fullturn.viz import report

    assert doctest.testmod(tables).failed == 0
    assert doctest.testmod(report).failed == 0
