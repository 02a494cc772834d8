"""Tables and figures as one page that needs nothing else."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence

from fullturn.evaluation.layout import Table, html_section
from fullturn.viz import page

_STYLE = """
main { grid-template-columns: minmax(0, 1fr); }
.numbers { font-size: 13px; white-space: nowrap; width: auto; min-width: 100%; }
.numbers th, .numbers td { padding: 3px 10px 3px 0; }
.numbers td { text-align: right; }
.numbers thead th { text-align: right; }
.numbers thead th:first-child, .numbers thead th:nth-child(2) { text-align: left; }
.numbers tr + tr td, .numbers tr + tr th { border-top: 0; }
.numbers tbody tr:first-child > *, .numbers tbody tr.block > * { border-top: 1px solid var(--line); }
.numbers tbody th { color: var(--ink); }
figure { margin: 0; padding: 8px; background: #ffffff; border-radius: 8px; }
figure img { display: block; width: 100%; height: auto; }
"""  # noqa: E501
CAPTIONS = {"curves": "Rotation errors", "risk_coverage": "Probabilities"}


def render_page(tables: Sequence[Table], pictures: Mapping[str, bytes], *, title: str) -> str:
    """The HTML: light or dark as the reader's system is, no script, nothing fetched.

    `pictures` are PNG files by name.
    """
    figures = "".join(
        f'<section class="card" id="{name}">\n<h2>{CAPTIONS[name]}</h2>\n<figure>'
        f'<img alt="{CAPTIONS[name]}: the figures behind it stand in the tables" '
        f'src="data:image/png;base64,{base64.b64encode(png).decode("ascii")}"></figure>\n'
        "</section>\n"
        for name, png in pictures.items()
    )
    sections = f"{html_section(tables[0])}{figures}{''.join(map(html_section, tables[1:]))}"
    body = "<header><h1>$title</h1></header>\n<main>\n$sections</main>"
    return page.render_page(body, {"title": title, "sections": sections}, title=title, style=_STYLE)
