"""What is written reads back exactly, and a failed write leaves nothing behind."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fullturn.errors import InputError, ReadError, WriteError
from fullturn.io import load_cloud, read_transform, save_cloud, write_transform
from fullturn.io.atomic import check_output, write_atomic

POINTS = np.random.default_rng(0).normal(size=(40, 3)) * 1e3 + 1e6


@pytest.mark.parametrize("suffix", [".ply", ".npy", ".xyz", ".txt", ".csv"])
def test_clouds_read_back_exactly(suffix: str, tmp_path: Path) -> None:
    save_cloud(tmp_path / f"a{suffix}", POINTS)
    np.testing.assert_array_equal(load_cloud(tmp_path / f"a{suffix}").points, POINTS)
    assert os.listdir(tmp_path) == [f"a{suffix}"]


@given(hnp.arrays(np.float64, (4, 4), elements=st.floats(allow_nan=False, allow_infinity=False)))
@pytest.mark.parametrize("suffix", [".txt", ".json"])
def test_transforms_read_back_exactly(
    suffix: str, tmp_path_factory: pytest.TempPathFactory, T: np.ndarray
) -> None:
    path = tmp_path_factory.mktemp("transform") / f"T{suffix}"
    write_transform(path, T)
    np.testing.assert_array_equal(read_transform(path), T)


@pytest.mark.parametrize("name", ["missing/a.ply", "a.jpg", "folder.ply", "zero\0.ply"])
def test_a_place_that_cannot_be_written(name: str, tmp_path: Path) -> None:
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(WriteError, match="cannot write") as caught:
        save_cloud(f"{tmp_path}/{name}", POINTS)
    assert "\n" not in str(caught.value)
    assert os.listdir(tmp_path) == ["folder.ply"]


@pytest.mark.parametrize("name", ["long" * 100 + ".ply", "circle.ply", "lost.ply"])
def test_what_only_the_write_would_meet_is_found_before(name: str, tmp_path: Path) -> None:
    (tmp_path / "circle.ply").symlink_to(tmp_path / "circle.ply")
    (tmp_path / "lost.ply").symlink_to(tmp_path / "missing" / "a.ply")
    for check in (check_output, lambda path: save_cloud(path, POINTS)):
        with pytest.raises(WriteError, match="cannot write") as caught:
            check(tmp_path / name)
        assert "\n" not in str(caught.value)
    assert sorted(os.listdir(tmp_path)) == ["circle.ply", "lost.ply"]


def test_a_folder_that_takes_no_files_is_found_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert check_output(tmp_path / "a.txt") == tmp_path / "a.txt"
    assert os.listdir(tmp_path) == []
    if Path("/proc/self").exists():
        with pytest.raises(WriteError, match=r"cannot write /proc/x\.txt: .*; choose a place"):
            check_output("/proc/x.txt", (".txt",))

    def denied(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    # Not by chmod: the superuser writes everywhere.
    monkeypatch.setattr(tempfile, "TemporaryFile", denied)
    with pytest.raises(WriteError, match="Permission denied; choose a place"):
        check_output(tmp_path / "a.txt")


def test_a_failed_write_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(WriteError, match="No space left"):
        write_atomic(path, "new")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_links_and_modes_are_kept(tmp_path: Path) -> None:
    (tmp_path / "real.txt").write_text("old")
    (tmp_path / "real.txt").chmod(0o640)
    (tmp_path / "link.txt").symlink_to(tmp_path / "real.txt")
    write_atomic(tmp_path / "link.txt", "new")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "real.txt").read_text() == "new"
    assert (tmp_path / "real.txt").stat().st_mode & 0o777 == 0o640


def test_transforms_are_checked(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="4×4"):
        write_transform(tmp_path / "T.txt", np.eye(3))
    with pytest.raises(InputError, match="finite"):
        write_transform(tmp_path / "T.txt", np.full((4, 4), np.nan))
    (tmp_path / "T.txt").write_text("1 2 3\n")
    with pytest.raises(ReadError, match="4×4"):
        read_transform(tmp_path / "T.txt")
    with pytest.raises(ReadError, match="cannot be read"):
        read_transform(tmp_path / "missing.txt")
