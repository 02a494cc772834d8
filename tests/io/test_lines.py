"""Lines with checksums: what is kept, what is dropped, and whose file it is."""

from __future__ import annotations

import json
import zlib
from pathlib import Path
from typing import Any

import pytest

from fullturn.errors import InputError, WriteError
from fullturn.io.lines import CheckedLines


def found(path: Path, header: str | None = None) -> tuple[list[dict[str, Any]], CheckedLines]:
    taken: list[dict[str, Any]] = []
    return taken, CheckedLines(path, taken.append, otherwise="use another", header=header)


def test_the_format_stays(tmp_path: Path) -> None:
    _, lines = found(tmp_path / "new" / "lines")
    lines.add({"key": "a", "value": 0.1})
    check = zlib.crc32(b'{"key": "a", "value": 0.1}')
    expected = f'{{"key": "a", "value": 0.1, "check": {check}}}\n'
    assert (tmp_path / "new" / "lines").read_text() == expected
    assert found(tmp_path / "new" / "lines")[0] == [{"key": "a", "value": 0.1}]


@pytest.mark.parametrize("header", [None, "whose lines these are"])
def test_damaged_lines_are_dropped_and_counted(tmp_path: Path, header: str | None) -> None:
    path = tmp_path / "lines"
    _, lines = found(path, header)
    for number in range(3):
        lines.add({"number": number})
    good = path.read_bytes()
    path.write_bytes(good.replace(b'"number": 1', b'"number": 7') + b"\xff[]\n7\nnull\n{}\n")
    taken, lines = found(path, header)
    assert taken == [{"number": 0}, {"number": 2}]
    assert lines.damaged == 5
    assert found(path, header)[1].damaged == 0
    # Cut off: the last line is lost, and the next one begins on a line of its own.
    path.write_bytes(path.read_bytes()[:-3])
    found(path, header)[1].add({"number": 3})
    assert found(path, header)[0] == [{"number": 0}, {"number": 3}]


def test_a_file_that_is_taken_away_begins_again_with_its_header(tmp_path: Path) -> None:
    path = tmp_path / "lines"
    _, lines = found(path, "whose lines these are")
    path.unlink()
    for number in range(2):
        lines.add({"number": number})
    assert found(path, "whose lines these are")[0] == [{"number": 0}, {"number": 1}]


def test_what_nobody_can_use_is_damaged(tmp_path: Path) -> None:
    _, lines = found(tmp_path / "lines")
    lines.add({"other": 1})

    def take(content: dict[str, Any]) -> None:
        content["key"]

    assert CheckedLines(tmp_path / "lines", take, otherwise="use another").damaged == 1


@pytest.mark.parametrize("content", ["", "something\n", json.dumps({}) + "\n"])
def test_a_file_with_another_header_is_left_alone(tmp_path: Path, content: str) -> None:
    (tmp_path / "lines").write_text(content)
    with pytest.raises(InputError, match=r"begins with mine, its first line .*; use another"):
        found(tmp_path / "lines", "mine")
    assert (tmp_path / "lines").read_text() == content


def test_a_place_that_cannot_be_used_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(WriteError, match=r"cannot use the cache .*; use another"):
        found(tmp_path)
    _, lines = found(tmp_path / "file" / "below")
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match=r"cannot write the cache .*; use another"):
        lines.add({})
