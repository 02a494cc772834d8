"""The folder of results: parts whole or missing, other inputs refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fullturn.cluster.pairs import PairTable, read_pairs
from fullturn.cluster.store import MANIFEST, Store, Tally, result_schema
from fullturn.cluster.work import Job, failed_row
from fullturn.errors import InputError, WriteError
from fullturn.methods.consensus import Consensus

pq = pytest.importorskip("pyarrow.parquet")

JOB = Job("/data", "consensus", 0, "code", version="1")


def table(folder: Path, text: str = "source,target\na,b\nc,d\ne,f\n") -> PairTable:
    path = folder / "pairs.csv"
    path.write_text(text)
    return read_pairs(path, method=Consensus)


def result(name: str) -> dict[str, Any]:
    pose = [float(i) for i in range(16)]
    return {
        "id": name,
        "source": "a",
        "target": "b",
        "status": "done",
        "T_target_source": pose,
        "success_probability": 0.5,
        "alternatives": 2,
        "alternative_T_target_source": [pose, pose],
        "alternative_success_probability": [0.25, 0.125],
        "covariance": [0.1] * 36,
        "notes": ["one", "two"],
        "seconds": 1.0,
    }


def test_rows_come_back_as_they_were(tmp_path: Path) -> None:
    pairs = table(tmp_path)
    out = tmp_path / "new" / "out"
    store = Store(out, pairs, JOB, part_size=2)
    (_, first), (_, second) = pairs.parts(2)
    assert store.tally(0, first) is None
    written = [result("0"), failed_row(first[1], "a reason")]
    # In any order, as parts end.
    assert store.write(1, [result("2")]) == Tally(1)
    assert store.write(0, written) == Tally(1, (("1", "a reason"),))

    again = Store(out, pairs, JOB, part_size=2)
    assert again.tally(0, first) == Tally(1, (("1", "a reason"),))
    assert again.tally(1, second) == Tally(1)
    whole = pq.read_table(out)
    assert whole.schema.equals(result_schema())
    assert whole["id"].to_pylist() == ["0", "1", "2"]
    for found, expected in zip(whole.to_pylist(), [*written, result("2")], strict=True):
        assert {key: value for key, value in found.items() if value is not None} == expected


def test_what_isnt_the_part_is_made_again(tmp_path: Path) -> None:
    pairs = table(tmp_path)
    store = Store(tmp_path / "out", pairs, JOB, part_size=2)
    (_, first), (_, second) = pairs.parts(2)
    store.write(0, [result("0"), result("1")])
    path = tmp_path / "out" / "part-000000.parquet"
    content = path.read_bytes()
    for wrong in (b"", content[:-30], content[: len(content) // 2], b"PAR1", b"text" * 99):
        path.write_bytes(wrong)
        assert store.tally(0, first) is None
    flipped = 0
    for place in range(0, len(content), 7):  # one bit at a time
        wrong = bytearray(content)
        wrong[place] ^= 0x10
        path.write_bytes(wrong)
        found = store.tally(0, first)
        flipped += found is None
        if found is not None:
            whole = pq.read_table(path).to_pylist()
            path.write_bytes(content)
            assert whole == pq.read_table(path).to_pylist(), place
    assert flipped > 20
    path.write_bytes(content)
    assert store.tally(0, first) is not None
    assert store.tally(0, second) is None  # other rows
    pq.write_table(pq.read_table(path).select(["id", "status"]), path)
    assert store.tally(0, first) is None


def test_results_of_something_else_are_refused(tmp_path: Path) -> None:
    pairs, out = table(tmp_path), tmp_path / "out"
    Store(out, pairs, replace(JOB, seed=5), part_size=9)  # without any result, anybody's
    Store(out, pairs, JOB, part_size=2).write(0, [result("0"), result("1")])
    others: list[tuple[PairTable, Job, int, str]] = [
        (table(tmp_path, "source,target\na,b\nc,d\ne,g\n"), JOB, 2, r"\(table differ"),
        (table(tmp_path, "source,target\na,b\n"), JOB, 2, r"\(pairs, table differ"),
        (pairs, replace(JOB, method="icp-plane", code="x"), 2, r"\(method, code differ"),
        (pairs, replace(JOB, seed=1, version="2"), 2, r"\(fullturn, seed differ"),
        (pairs, replace(JOB, folder="/elsewhere"), 2, r"\(folder differ"),
        (pairs, JOB, 3, r"\(part_size differ"),
    ]
    for one, job, size, message in others:
        with pytest.raises(InputError, match=message):
            Store(out, one, job, part_size=size)
    assert json.loads((out / MANIFEST).read_text())["pairs"] == 3
    for text in ("", "[]", '{"format": 0}', "\0"):
        (out / MANIFEST).write_text(text)
        with pytest.raises(InputError, match="expected results of these pairs"):
            Store(out, pairs, JOB, part_size=2)
    (out / MANIFEST).unlink()
    with pytest.raises(InputError, match=f"Parquet files and no {MANIFEST}"):
        Store(out, pairs, JOB, part_size=2)


def test_a_folder_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match="cannot make the folder"):
        Store(tmp_path / "file" / "out", table(tmp_path), JOB, part_size=2)
