"""The table of pairs: what it may say, and one line for whatever it says wrong."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from fullturn.cluster.pairs import PairRow, read_pairs
from fullturn.errors import InputError, ReadError
from fullturn.methods.consensus import Consensus
from fullturn.methods.registry import get


def table(folder: Path, text: str | bytes) -> Path:
    path = folder / "pairs.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_every_column(tmp_path: Path) -> None:
    text = (
        "\ufeffid,weight,source,target,source_viewpoint,target_viewpoint,max_rotation_deg\r\n"
        'a, 1 ,x.ply, "y, z.ply",0 -1 2.5,"3,4,5",45\r\n'
        "\r\n"
        "b,,/far/x.ply,y.ply,,,\r\n"
    )
    pairs = read_pairs(table(tmp_path, text), method=Consensus)
    assert (pairs.count, pairs.unused, pairs.folder) == (2, ("weight",), str(tmp_path.resolve()))
    assert list(pairs.parts(5)) == [
        (
            0,
            [
                PairRow("a", "x.ply", "y, z.ply", (0.0, -1.0, 2.5), (3.0, 4.0, 5.0), 45.0),
                PairRow("b", "/far/x.ply", "y.ply"),
            ],
        )
    ]


@pytest.mark.parametrize(("count", "size"), [(1, 1), (7, 3), (6, 3), (5, 9)])
def test_parts_hold_every_row_once_in_order(count: int, size: int, tmp_path: Path) -> None:
    text = "target,source\n" + "".join(f"t{i},s{i}\n" for i in range(count))
    parts = list(read_pairs(table(tmp_path, text), method=Consensus).parts(size))
    assert [number for number, _ in parts] == list(range(math.ceil(count / size)))
    assert {len(rows) for _, rows in parts[:-1]} <= {size}
    rows = [row for _, rows in parts for row in rows]
    assert rows == [PairRow(str(i), f"s{i}", f"t{i}") for i in range(count)]


def test_the_digest_is_of_what_the_rows_say(tmp_path: Path) -> None:
    def digest(text: str | bytes) -> str:
        return read_pairs(table(tmp_path, text), method=Consensus).digest

    first = digest("source,target\na,b\nc,d\n")
    assert digest('target,source,more\r\n"b",a,1\r\nd, c ,2') == first
    assert digest("source,target\na,b\nc,d\n".encode("utf-16")) == first
    others = ["a,b\nc,e\n", "c,d\na,b\n", "a,b\n", "a,b\nc,d\nc,d\n"]
    assert first not in {digest("source,target\n" + text) for text in others}


def test_a_run_reads_what_was_checked(tmp_path: Path) -> None:
    path = table(tmp_path, "source,target\na,b\n")
    pairs = read_pairs(path, method=Consensus)
    path.write_text("nothing")
    assert list(pairs.parts(1)) == [(0, [PairRow("0", "a", "b")])]


HEAD = "id,source,target,source_viewpoint,max_rotation_deg\n"


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("", ReadError, "the file is empty"),
        ("\n\n", ReadError, "the file is empty"),
        (b"source,target\n\xff,b\n", ReadError, "UTF-8"),
        ('source,target\n"a,b\n', ReadError, "comma-separated"),
        ("a,b\nc,d\n", InputError, "line 1: expected the columns source and target"),
        ("source;target\na;b\n", InputError, "source;target; separate the columns by commas"),
        ("source\ttarget\na\tb\n", InputError, "separate the columns by commas"),
        ("source\na\n", InputError, "got source; name a column target"),
        ("source,name\na,b\n", InputError, "name a column target"),
        ("source,target,id,id\na,b,c,d\n", InputError, "got id twice"),
        ("source,target\n", InputError, "at least one pair"),
        (HEAD + "1,a,b,,\n2,c,d\n", InputError, "line 3: expected 5 cells as in the first line"),
        (HEAD + "1,a,b,,,,\n", InputError, "line 2: expected 5 cells .* got 7"),
        (HEAD + "1,a,,,\n", InputError, "line 2, column target: expected a value"),
        (HEAD + "1,,b,,\n", InputError, "line 2, column source: expected a value"),
        (HEAD + ",a,b,,\n", InputError, "line 2, column id: expected a value"),
        (HEAD + "1,a,b,,\n2,a,b,,\n1,c,d,,\n", InputError, "line 4, column id: .* that of line 2"),
        (HEAD + "1,a,b,0 1,\n", InputError, "line 2, column source_viewpoint: .*got 0 1;"),
        (HEAD + "1,a,b,0 1 nan,\n", InputError, "line 2, column source_viewpoint: expected three"),
        (HEAD + "1,a,b,,far\n", InputError, "line 2, column max_rotation_deg: .*got far"),
        (HEAD + "1,a,b,,270\n", InputError, "line 2, column max_rotation_deg: .*up to 180"),
        (HEAD + "1,a,b,,nan\n", InputError, "line 2, column max_rotation_deg: .*up to 180"),
    ],
)
def test_bad_tables_are_named_by_line_and_column(
    text: str | bytes, error: type[Exception], message: str, tmp_path: Path
) -> None:
    with pytest.raises(error, match=message) as caught:
        read_pairs(table(tmp_path, text), method=Consensus)
    assert "\n" not in str(caught.value)
    assert "pairs.csv" in str(caught.value)


def test_a_largest_rotation_needs_a_method_that_takes_one(tmp_path: Path) -> None:
    path = table(tmp_path, HEAD + "1,a,b,,45\n")
    with pytest.raises(InputError, match=r"line 2, column max_rotation_deg: .*got icp-point"):
        read_pairs(path, method=get("icp-point"))


@pytest.mark.parametrize("pairs", [None, [("a", "b")], 5])
def test_what_is_no_path(pairs: Any) -> None:
    with pytest.raises(InputError, match=r"pairs: expected the path of a CSV table, got a \w+;"):
        read_pairs(pairs, method=Consensus)


@pytest.mark.parametrize("name", ["none.csv", ".", "a\0b"])
def test_what_is_no_file(name: str, tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="expected a table of pairs"):
        read_pairs(tmp_path / name, method=Consensus)
