"""One table, written as Markdown, LaTeX or HTML."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from fullturn.viz.tables import text as html_text

_LATEX = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "&": r"\&", "%": r"\%", "$": r"\$",
    "#": r"\#", "_": r"\_", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": "$<$",
    ">": "$>$", "|": r"\textbar{}", "°": r"\textdegree{}", "−": "$-$", "†": r"\dag{}",
    "‡": r"\ddag{}", "–": "--", "Δ": r"$\Delta$", "≤": r"$\le$", "×": r"$\times$",
}  # fmt: skip
NONE = "–"  # where there is no number
LATEX_HEAD = "% Needs \\usepackage{booktabs,graphicx}\n"


@dataclass(frozen=True)
class Table:
    """Cells of plain text; the writers below escape them."""

    name: str  # a label: letters, digits and hyphens
    title: str
    # Per column its headings, from the topmost; equal neighbors at the top are one heading.
    header: tuple[tuple[str, ...], ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    text_columns: int = 1  # at the left; the rest are numbers
    rules: frozenset[int] = frozenset()  # rows that start a new block


def number(value: float, form: int | str) -> str:
    """A number with `form` decimals; "%": a share in percent, "°": an angle.

    >>> number(0.5, "%"), number(0.0364, "°"), number(18.134, "°"), number(0.5, 3)
    ('50.0', '0.036', '18.13', '0.500')
    """
    if form == "%":
        return f"{100.0 * value:.1f}"
    # Means of clean pairs are thousandths of a degree, those of hard ones tens of degrees.
    return f"{value:.{(3 if abs(value) < 1.0 else 2) if form == '°' else form}f}"


def plain_header(names: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Headings of one level."""
    return tuple((name,) for name in names)


def markdown(table: Table) -> str:
    """The table alone, without title and notes.

    >>> print(markdown(Table("t", "T", (("a",), ("b",)), (("x|y", "1"),))), end="")
    | a | b |
    | --- | ---: |
    | x\\|y | 1 |
    """
    header = [", ".join(filter(None, levels)) for levels in table.header]
    rule = ["---" if column < table.text_columns else "---:" for column in range(len(table.header))]
    # A "<" before a letter would start a tag; before a digit it is itself.
    lines = [[_markdown_text(cell) for cell in line] for line in (header, *table.rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in [lines[0], rule, *lines[1:]])


def markdown_section(table: Table) -> str:
    """Title, table and notes."""
    notes = "".join(f"\n{_markdown_text(note)}\n" for note in table.notes)
    return f"## {table.title}\n\n{markdown(table)}{notes}"


def latex(table: Table) -> str:
    """A floating table as wide as the text; `LATEX_HEAD` says what it needs."""
    left, width = table.text_columns, len(table.header)
    lines = [
        "\\begin{table*}",
        f"\\caption{{{latex_text(' '.join((table.title + '.', *table.notes)))}}}",
        f"\\label{{tab:{table.name}}}",
        "\\centering",
        "\\resizebox{\\ifdim\\width>\\linewidth\\linewidth\\else\\width\\fi}{!}{%",
        f"\\begin{{tabular}}{{{'l' * left}{'r' * (width - left)}}}",
        "\\toprule",
        *_latex_header(table),
        "\\midrule",
    ]
    for number, row in enumerate(table.rows):
        if number and number in table.rules:
            lines.append("\\midrule")
        # Braces: a row that begins with a bracket would be read as an option of the line break.
        lines.append("{}" + " & ".join(map(latex_text, row)) + " \\\\")
    lines += ["\\bottomrule", "\\end{tabular}%", "}", "\\end{table*}"]
    return "\n".join(lines) + "\n"


def latex_text(text: str) -> str:
    """Text in which no character is a command.

    >>> latex_text("50 % of a_b, <5°")
    '50 \\\\% of a\\\\_b, $<$5\\\\textdegree{}'
    """
    return "".join(_LATEX.get(letter, letter) for letter in text)


def html_section(table: Table) -> str:
    """Title, table and notes as a piece of a page."""
    rows = []
    for level in range(len(table.header[0])):
        cells = "".join(
            f'<th scope="col"{f" colspan={span}" if span > 1 else ""}>{html_text(text)}</th>'
            for text, span in _merged(table.header, level)
        )
        rows.append(f"<tr>{cells}</tr>")
    body = []
    for number, row in enumerate(table.rows):
        style = ' class="block"' if number in table.rules else ""
        cells = "".join(
            f'<th scope="row">{html_text(cell)}</th>'
            if column < table.text_columns
            else f"<td>{html_text(cell)}</td>"
            for column, cell in enumerate(row)
        )
        body.append(f"<tr{style}>{cells}</tr>")
    notes = "".join(f'<p class="sub">{html_text(note)}</p>' for note in table.notes)
    return (
        f'<section class="card wide" id="{table.name}">\n<h2>{html_text(table.title)}</h2>\n'
        f'<table class="numbers">\n<thead>{"".join(rows)}</thead>\n'
        f"<tbody>\n{chr(10).join(body)}\n</tbody>\n</table>\n{notes}\n</section>\n"
    )


def _merged(header: Sequence[tuple[str, ...]], level: int) -> list[tuple[str, int]]:
    """The headings of a level with their widths; only those under one heading are merged."""
    last = level == len(header[0]) - 1
    keys = [(*levels[: level + 1], column if last else 0) for column, levels in enumerate(header)]
    return [(str(key[level]), len(list(same))) for key, same in groupby(keys)]


def _latex_header(table: Table) -> list[str]:
    lines = []
    for level in range(len(table.header[0])):
        cells, rules, column = [], [], 1
        for text, span in _merged(table.header, level):
            cell = latex_text(text)
            cells.append(cell if span == 1 else f"\\multicolumn{{{span}}}{{c}}{{{cell}}}")
            if span > 1 and text:
                rules.append(f"\\cmidrule(lr){{{column}-{column + span - 1}}}")
            column += span
        lines += [" & ".join(cells) + " \\\\", *rules]
    return lines


def _markdown_text(text: str) -> str:
    for letter in "\\|*`":
        text = text.replace(letter, f"\\{letter}")
    return " ".join(text.split())
