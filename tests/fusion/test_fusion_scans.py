"""What scans are called: enough to tell them apart, and no more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fullturn.errors import InputError
from fullturn.fusion.scans import check_scans, scan_names
from fullturn.io import LoadedCloud, save_cloud


@pytest.mark.parametrize(
    ("clouds", "names"),
    [
        (["x/a.ply", "x/b.ply"], ["a.ply", "b.ply"]),
        (["x/a.ply", "y/a.ply", "x/b.ply"], ["x/a.ply", "y/a.ply", "b.ply"]),
        (["1/x/a.ply", "2/x/a.ply"], ["1/x/a.ply", "2/x/a.ply"]),
        (["x/a.ply", "a.ply"], ["x/a.ply", "a.ply"]),
        (["x/a.ply", "x/a.ply"], ["a.ply", "a.ply"]),
        ([np.zeros((4, 3)), Path("x/a.ply")], ["scan 1", "a.ply"]),
        ([LoadedCloud(np.zeros((4, 3)), name="left"), np.zeros((4, 3))], ["left", "scan 2"]),
    ],
)
def test_names_are_as_short_as_they_can_be(clouds: list[object], names: list[str]) -> None:
    assert scan_names(clouds) == names


def test_what_is_left_out_has_its_folder_where_names_repeat(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(3, 50, 3))
    paths = [tmp_path / folder / "scan.ply" for folder in "abc"]
    for path, cloud in zip(paths, (points[0], points[1], points[0]), strict=True):
        path.parent.mkdir()
        save_cloud(path, cloud)
    scans, notes = check_scans(paths)
    assert [scan.name for scan in scans] == ["a/scan.ply", "b/scan.ply"]
    assert notes == ["left out c/scan.ply: it holds the same points as a/scan.ply"]


def test_one_path_alone_is_no_list() -> None:
    with pytest.raises(InputError, match="at least 2 scans, got a str; give a list"):
        check_scans("a.ply")


@pytest.mark.parametrize("offset", [0.0, 1e7])
def test_the_same_points_in_another_order_or_precision_are_the_same(offset: float) -> None:
    rng = np.random.default_rng(0)
    one, other = (rng.normal(size=(300, 3)) + offset for _ in range(2))
    mixed = one[rng.permutation(300)]
    scans, notes = check_scans([one, mixed, other])
    assert [scan.name for scan in scans] == ["scan 1", "scan 3"]
    assert notes[0] == "left out scan 2: it holds the same points as scan 1"
    if offset == 0.0:
        scans, notes = check_scans([one, mixed.astype(np.float32), other])
        assert [scan.name for scan in scans] == ["scan 1", "scan 3"]


@pytest.mark.parametrize("far", [1e3, 1e20, 1e100])
def test_stray_points_change_nothing_that_is_kept_of_a_scan(far: float) -> None:
    rng = np.random.default_rng(0)
    one, other = (rng.normal(size=(300, 3)) for _ in range(2))
    strays = far * rng.normal(size=(2, 3))
    (plain, _), _ = check_scans([one, other])
    (scan, _), notes = check_scans([np.vstack([one, strays]), other])
    np.testing.assert_allclose(scan.sample, plain.sample, atol=1e-12)
    assert (scan.spacing, scan.radius) == pytest.approx((plain.spacing, plain.radius))
    assert [note[:39] for note in notes] == ["scan 1: 2 points lie far from the rest,"]
