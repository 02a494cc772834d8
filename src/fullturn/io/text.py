"""Read points from text: XYZ, TXT, CSV and their relatives."""

from __future__ import annotations

import codecs
import io
import math
import re

import numpy as np

from fullturn.errors import ReadError, one_line
from fullturn.io.raw import Raw

_PLACE = "p|pos|position|pt|pts|point|points|coord|coords|coordinate|coordinates|loc|location"
_UNIT = "[mcdknuµ]?m|in|inch|inches|ft|feet|meters?|metres?|(?:milli|centi)met(?:er|re)s?"
# Of a name in lower case whose other marks became spaces: "pos x", "x mm"; "points 0" (ParaView),
# "points m xyz 0" (VeloView), "0" (pandas).
_AXIS = re.compile(rf"(?:(?:{_PLACE}) ?)?([xyz])(?: (?:{_PLACE}))?(?: (?:{_UNIT}))?")
_NUMBERED = re.compile(rf"(?:(?:{_PLACE}) (?:m xyz )?)?([012])")
# "[m]" or "(mm)" after a name, but not "[x]" or "[0]".
_BRACKETS = re.compile(r"\s*[\[({](?!\s*[xyz012]\s*[\])}])[^\])}]*[\])}]", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
# A word may be quoted, and then hold what else separates.
_WORDS: dict[str | None, re.Pattern[str]] = {
    None: re.compile(r'((?:"[^"]*")+|\S+)'),
    **{mark: re.compile(rf'(?:^|{mark})((?:\s*(?:"[^"]*")+)?[^{mark}]*)') for mark in ",;\t"},
}
_CONTROL = re.compile(rb"[\0-\x08\x0e-\x1f]")  # no text holds it
_BETWEEN = "\x1f"  # ASCII's separator of units: no line of numbers holds it


def read_text(data: bytes, name: str) -> Raw:
    """Points from lines of numbers: the columns named x, y and z, or else the first three.

    Spaces, tabs, commas or semicolons separate, and words may be quoted; `#` starts a comment, but
    not inside another column of a table. A header and the number of points may come first, and
    after so many points another number of more (several stations in one file, as in PTS); a
    comment directly above the data that names every column is a header, too. Names may have a unit
    and say what they are: `X [m]`, `pos_x`, `px`, `Points:0`. Other columns are ignored.

    Raises:
        ReadError: binary data, a line without three numbers, fewer lines than announced, more than
            three columns and a header that names none of them x, y and z.
    """
    lines = _decoded(data, name).splitlines()
    first, header, announced = _opening(lines)
    notes: tuple[str, ...] = ()
    if header is None and _counts_columns(lines, first):
        notes = (f"{name}: its first line numbers the columns and is left out",)
        first += 1
    start = _next(lines, first)
    if start is None:
        return Raw(np.zeros((0, 3)))
    if header is None:
        above = next((line for line in reversed(lines[:start]) if line.strip()), "")
        header = above if above.lstrip().startswith("#") else None
    if announced is not None:
        announced += _more_announced(lines, start, announced)
    columns, separator = _columns(header, lines[start], name)
    try:
        points = _numbers(lines[start:], columns, separator)
    except (ValueError, IndexError, OverflowError) as error:
        raise _line_error(lines, start, columns, separator, name, error) from error
    if announced is not None and len(points) != announced:
        raise ReadError(
            f"{name}: it announces {announced} points, {len(points)} came; "
            "the file is truncated or damaged"
        )
    return Raw(points, notes=notes)


def encoding_of(data: bytes) -> str:
    """UTF-16 where its mark comes first, as PowerShell writes it, or else UTF-8."""
    is_wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return "utf-16" if is_wide else "utf-8-sig"


def _decoded(data: bytes, name: str) -> str:
    encoding = encoding_of(data)
    try:
        if encoding == "utf-16" or b"\0" not in data[:4096]:
            return data.decode(encoding)
    except UnicodeDecodeError:
        if encoding != "utf-16" and not _CONTROL.search(data):
            return data.decode("cp1252", "replace")  # Windows' older one; numbers are the same
    raise ReadError(f"{name}: expected text, found binary data; check the file or its suffix")


def three_numbers(text: str) -> tuple[float, float, float] | None:
    """Three finite numbers with commas or spaces between them; None where it isn't that.

    >>> three_numbers("0.1, -2 3")
    (0.1, -2.0, 3.0)
    """
    try:
        x, y, z = map(float, text.replace(",", " ").split())
    except ValueError:
        return None
    return (x, y, z) if all(map(math.isfinite, (x, y, z))) else None


def _opening(lines: list[str]) -> tuple[int, str | None, int | None]:
    """Where the data may begin, the header (the last of several comments), the number of points."""
    first, header, announced = 0, None, None
    while (at := _next(lines, first)) is not None:
        words = _split(_content(lines[at]), _separator(lines[at]))
        word = next(filter(None, words), "")
        names = not _is_number(word.replace(",", ".")) or words[:4] == ["", "0", "1", "2"]
        is_comment = lines[at].lstrip().startswith(("//", "%"))
        if announced is None and len(words) == 1 and word.isdecimal():
            announced = int(word)
        elif names and (is_comment or (header is None and not _is_damaged(words, lines, at))):
            header = lines[at]
        else:
            break
        first = at + 1
    return first, header, announced


def _is_damaged(words: list[str], lines: list[str], at: int) -> bool:
    """Whether the words of a line are mostly numbers, as many as in the next one: no header."""
    following = _next(lines, at + 1)
    if following is None or {"0", "1", "2"} <= set(words):
        return False
    count = len(_split(_content(lines[following]), _separator(lines[following])))
    return len(words) == count and sum(map(_is_number, words)) > count / 2


def _more_announced(lines: list[str], start: int, announced: int) -> int:
    """The sum of further numbers of points, each of which is taken out of the lines.

    A number of points stands alone on the line after the last of those that the one before it
    announced.
    """
    rows = [i for i in range(start, len(lines)) if _holds_more_than_a_comment(lines[i])]
    at, more = announced, 0
    while at < len(rows) and (count := _content(lines[rows[at]])).isdecimal():
        lines[rows[at]] = ""
        at += 1 + int(count)
        more += int(count)
    return more


def _counts_columns(lines: list[str], first: int) -> bool:
    """Whether a line is 0, 1, 2 and so on, as pandas names columns, above decimal numbers."""
    at = _next(lines, first)
    following = None if at is None else _next(lines, at + 1)
    if at is None or following is None:
        return False
    words = _split(lines[at], _separator(lines[at]))
    counted = [str(k) for k in range(max(3, len(words)))]
    return words == counted and "." in _content(lines[following])


def _numbers(lines: list[str], columns: list[int], separator: str | None) -> np.ndarray:
    rows = [line for line in lines if _holds_more_than_a_comment(line)]
    text = "\n".join(rows)
    if any(mark in text for mark in "\"'#"):
        text = "\n".join(_BETWEEN.join(_words(row, columns, separator)) for row in rows)
        columns, separator = [0, 1, 2], _BETWEEN
    stream = io.StringIO(text)
    return np.loadtxt(stream, usecols=columns, ndmin=2, comments=None, delimiter=separator)


def _words(row: str, columns: list[int], separator: str | None) -> list[str]:
    """The words in these columns; a comment may follow the last of them, or stand in another."""
    words = _split(_uncommented(row, separator), separator)
    words[max(columns)] = words[max(columns)].split("#", 1)[0]
    return [words[column] for column in columns]


def _next(lines: list[str], first: int) -> int | None:
    """The index of the next line that is more than a comment."""
    at = range(first, len(lines))
    return next((i for i in at if _holds_more_than_a_comment(lines[i])), None)


def _holds_more_than_a_comment(line: str) -> bool:
    return bool(line.split("#", 1)[0].strip())


def _content(line: str) -> str:
    """The line without comment and blanks; `//` headers (CloudCompare) lose their mark."""
    mark = _separator(line) or ("\t" if "\t" in line else None)
    return _uncommented(line, mark).strip().removeprefix("//").strip()


def _uncommented(line: str, separator: str | None) -> str:
    """The line without its comment, unless that may be a word of a table."""
    return line.split("#", 1)[0] if separator is None else line


def _separator(line: str) -> str | None:
    return next((mark for mark in ";," if mark in line.split("#", 1)[0]), None)


def _split(text: str, separator: str | None) -> list[str]:
    """The words without quotes; empty ones stay, but not at the end."""
    words = [word.strip().strip("\"'").strip() for word in _WORDS[separator].findall(text)]
    while words and not words[-1]:
        words.pop()
    return words


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _columns(header: str | None, row: str, name: str) -> tuple[list[int], str | None]:
    """Which columns of the data are x, y and z, and what separates them."""
    separator = _separator(row)
    if header is None:
        return [0, 1, 2], separator
    text = header.strip(" ").removeprefix("//")
    comment = text.startswith(("#", "%"))
    if comment:  # "# columns: x y z" begins with a word that is no name.
        text = re.sub(r"^[^,;\t:]*:\s+", "", text.lstrip("#%").strip(" "))
    text = _BRACKETS.sub("", text)
    # What both lines have as many of separates, though it comes after a "#" or among blanks.
    mark = next((mark for mark in ";,\t" if text.count(mark) == row.count(mark) > 0), None)
    mark, separator = (mark, mark) if mark else (_separator(text), separator)
    names = [name.split("#", 1)[0] for name in _split(_uncommented(text, mark), mark)]
    count = len(_split(_uncommented(row, separator), separator))
    columns = _axes(names)
    if comment and len(names) != count:
        return [0, 1, 2], separator
    if columns is not None:
        if len(names) == count - 1 and re.fullmatch(r'"[^"]*"[^"]+', row):
            columns = [column + 1 for column in columns]  # R writes names of rows without a header
        return columns, separator
    # Words in a comment may be a sentence, and so may another number of them in the first line.
    if len(names) == count > 3 and (mark is not None or not comment):
        raise ReadError(
            f"{name}: expected columns x, y, z in the header, got "
            f"{one_line(', '.join(names))[:200]}; name the three columns x, y and z, or remove the "
            "header if they are the first three"
        )
    return [0, 1, 2], separator


def _axes(names: list[str]) -> list[int] | None:
    """The columns of three names that differ in nothing but x, y and z."""
    found: dict[str, dict[str, int]] = {}
    for column, name in enumerate(names):
        plain = re.sub(r"[^\w]+|_+", " ", name.lower()).strip()
        if match := _AXIS.fullmatch(plain) or _NUMBERED.fullmatch(plain):
            rest = f"{plain[: match.start(1)]}*{plain[match.end(1) :]}"
            axis = match[1].translate(str.maketrans("012", "xyz"))
            found.setdefault(rest, {}).setdefault(axis, column)
    triples = {rest: columns for rest, columns in found.items() if len(columns) == 3}
    best = triples.get("*") or next(iter(triples.values()), None)
    return None if best is None else [best[axis] for axis in "xyz"]


def _line_error(
    lines: list[str],
    start: int,
    columns: list[int],
    separator: str | None,
    name: str,
    error: Exception,
) -> ReadError:
    """Names the line that NumPy could not read; NumPy itself counts rows of the data from 0."""
    expected = "expected three numbers per line"
    if columns != [0, 1, 2]:
        expected += " in the columns {}, {} and {}".format(*(column + 1 for column in columns))
    expected += ", separated by spaces, tabs, commas or semicolons"
    for number, line in enumerate(lines[start:], start=start + 1):
        text = _uncommented(line, separator)
        if not _holds_more_than_a_comment(line) or _holds_numbers(line, columns, separator):
            continue
        came = f"{name}, line {number}: {expected}, got {one_line(text)[:80]}"
        parts = re.split(r'",\s*"|[;\s"]+', text.strip(' ;\t"'))
        commas = [_DECIMAL_COMMA.fullmatch(part) for part in parts]
        if any(commas) and all(
            comma or _is_number(part) for comma, part in zip(commas, parts, strict=True)
        ):
            return ReadError(f"{came}; it has decimal commas, write decimal points: 0.5, not 0,5")
        return ReadError(f"{came}; correct that line")
    return ReadError(f"{name}: {expected}: {one_line(error)[:200]}; correct that line")


def _holds_numbers(row: str, columns: list[int], separator: str | None) -> bool:
    try:
        words = _words(row, columns, separator)
    except IndexError:
        return False
    return all(_is_number(word) and "_" not in word for word in words)
