from __future__ import annotations

import dataclasses
import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fullturn.data import provenance
from fullturn.data.draw import ProtocolPairs
from fullturn.data.frozen import FrozenPairs, freeze
from fullturn.data.mixture import MixedPairs
from fullturn.data.pair import Pair
from fullturn.data.pair_set import PairSet
from fullturn.data.protocols import PROTOCOLS
from fullturn.data.shapes import ProceduralShapes
from fullturn.errors import InputError, ReadError, WriteError


def some_pairs(seed: int = 0) -> PairSet:
    protocol = PROTOCOLS["modelnet40/noisy/180"]
    return ProtocolPairs(protocol, ProceduralShapes(3), count=4, seed=seed)


def assert_same(a: Pair, b: Pair) -> None:
    for field in ("source", "target", "T_target_source", "source_viewpoint", "target_viewpoint"):
        first, second = getattr(a, field), getattr(b, field)
        assert (first is None) == (second is None)
        assert first is None or (first.dtype, first.tobytes()) == (second.dtype, second.tobytes())
    assert (a.name, a.related) == (b.name, b.related)
    assert a.max_rotation_deg == b.max_rotation_deg


def test_what_was_frozen_comes_back_to_the_byte(tmp_path: Path) -> None:
    # Of this mixture some pairs have viewpoints, some not, and the sizes differ.
    mixed = MixedPairs(ProceduralShapes(50, seed=4), count=12, seed=3)
    assert {mixed.group(i) for i in range(12)} >= {"scan", "unrelated", "plane"}
    for pairs in (some_pairs(), mixed):
        freeze(pairs, tmp_path / "pairs.npz")
        frozen = FrozenPairs(tmp_path / "pairs.npz")
        assert (frozen.name, len(frozen)) == (pairs.name, len(pairs))
        for i in range(len(pairs)):
            assert_same(frozen.pair(i), pairs.pair(i))
            assert frozen.group(i) == pairs.group(i)


class SomeKnown(PairSet):
    """Of the even pairs, the largest rotation is known."""

    name, description = "some", {"kind": "test"}

    def __len__(self) -> int:
        return 4

    def pair(self, index: int) -> Pair:
        limit_deg = 10.0 + index if index % 2 == 0 else None
        return dataclasses.replace(some_pairs().pair(index), max_rotation_deg=limit_deg)


def test_largest_rotations_come_back(tmp_path: Path) -> None:
    limited = ProtocolPairs(PROTOCOLS["rpmnet/45"], ProceduralShapes(3), count=2)
    for pairs in (limited, SomeKnown()):
        freeze(pairs, tmp_path / "pairs.npz")
        frozen = FrozenPairs(tmp_path / "pairs.npz")
        for i in range(len(pairs)):
            assert_same(frozen.pair(i), pairs.pair(i))
    # Where none is known, files are what they were before there was such a thing.
    freeze(some_pairs(), tmp_path / "pairs.npz")
    with np.load(tmp_path / "pairs.npz") as archive:
        assert "max_rotation_deg" not in archive.files


def test_pairs_that_a_method_spoils_are_read_afresh(tmp_path: Path) -> None:
    freeze(some_pairs(), tmp_path / "pairs.npz")
    frozen = FrozenPairs(tmp_path / "pairs.npz")
    frozen.pair(1).source[:] = 0.0
    assert_same(frozen.pair(1), some_pairs().pair(1))


def test_the_same_pairs_give_the_same_bytes(tmp_path: Path) -> None:
    first = freeze(some_pairs(), tmp_path / "a.npz")
    freeze(some_pairs(), tmp_path / "b.npz")
    other = freeze(some_pairs(seed=1), tmp_path / "c.npz")
    again = freeze(FrozenPairs(tmp_path / "a.npz"), tmp_path / "d.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert first["sha256"] == again["sha256"] != other["sha256"]


def test_the_manifest_says_where_it_comes_from(tmp_path: Path) -> None:
    freeze(some_pairs(seed=7), tmp_path / "pairs.npz")
    with np.load(tmp_path / "pairs.npz", allow_pickle=False) as archive:
        manifest = json.loads(str(archive["manifest"]))
    assert manifest["name"] == "modelnet40/noisy/180"
    assert (manifest["seed"], manifest["count"]) == (7, 4)
    assert manifest["description"] == some_pairs(seed=7).description
    frozen = FrozenPairs(tmp_path / "pairs.npz")
    assert frozen.description["frozen"]["sha256"] == manifest["sha256"]
    assert str(tmp_path) not in json.dumps(frozen.description)


def rewrite(path: Path, **changes: Any) -> None:
    with np.load(path) as archive:
        content = {key: archive[key] for key in archive.files}
    np.savez(path, **{**content, **changes})


def test_changed_files_are_named(tmp_path: Path) -> None:
    path = tmp_path / "pairs.npz"
    manifest = freeze(some_pairs(), path)
    rewrite(path, source=np.zeros((4 * 768, 3)))
    with pytest.raises(ReadError, match=f"expected arrays with the SHA-256 {manifest['sha256']}"):
        FrozenPairs(path)
    rewrite(path, manifest=np.array(json.dumps({**manifest, "format": 9})))
    with pytest.raises(ReadError, match="expected format 1, found 9"):
        FrozenPairs(path)
    rewrite(path, manifest=np.array("{"))
    with pytest.raises(ReadError, match="expected the manifest"):
        FrozenPairs(path)
    rewrite(path, manifest=np.array(json.dumps({"format": 1})))
    with pytest.raises(ReadError, match="expected a manifest with"):
        FrozenPairs(path)


def test_other_files_are_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(ReadError, match="missing: manifest"):
        FrozenPairs(tmp_path / "other.npz")
    freeze(some_pairs(), tmp_path / "cut.npz")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "cut.npz").read_bytes()[:5000])
    (tmp_path / "text.npz").write_text("no archive")
    for name in ("absent.npz", "cut.npz", "text.npz"):
        with pytest.raises(ReadError, match="could not read it"):
            FrozenPairs(tmp_path / name)


def test_a_bad_place_is_an_error_before_the_work(tmp_path: Path) -> None:
    class NoWork(ProtocolPairs):
        def pair(self, index: int) -> Pair:
            raise RuntimeError

    pairs = NoWork(PROTOCOLS["rpmnet/45"], ProceduralShapes(1), count=1)
    for path in (tmp_path / "pairs.txt", tmp_path / "absent" / "pairs.npz"):
        with pytest.raises(WriteError):
            freeze(pairs, path)


def test_numbers_out_of_range_are_errors(tmp_path: Path) -> None:
    freeze(some_pairs(), tmp_path / "pairs.npz")
    for pairs in (some_pairs(), FrozenPairs(tmp_path / "pairs.npz")):
        for index in (-1, 4):
            with pytest.raises(InputError, match=f"from 0 to 3, got {index}"):
                pairs.pair(index)
            with pytest.raises(InputError, match=f"from 0 to 3, got {index}"):
                pairs.group(index)
    with pytest.raises(InputError, match="at least 1 pair"):
        ProtocolPairs(PROTOCOLS["rpmnet/45"], ProceduralShapes(1), count=0)


def test_hashes_of_files(tmp_path: Path) -> None:
    for name, text in (("a", "one"), ("b", "two")):
        (tmp_path / name).write_text(text)
    both = [tmp_path / "a", tmp_path / "b"]
    first = provenance.sha256_of_files(both, root=tmp_path)
    assert provenance.sha256_of_files(both[::-1], root=tmp_path) == first
    (tmp_path / "a").write_text("One")
    assert provenance.sha256_of_files(both, root=tmp_path) != first
    with pytest.raises(ReadError, match="absent"):
        provenance.sha256_of_file(tmp_path / "absent")


def test_the_commit_is_that_of_this_tree_or_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    commit = provenance.working_tree_commit()
    assert commit is None or len(commit.removesuffix("-dirty")) == 40

    def no_git(*args: object, **options: object) -> None:
        raise FileNotFoundError("git")

    monkeypatch.setattr(subprocess, "run", no_git)
    assert provenance.working_tree_commit() is None
