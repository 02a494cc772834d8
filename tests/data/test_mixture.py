from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fullturn.data import mixture
from fullturn.data.mixture import KINDS, MixedPairs, mixed_pair
from fullturn.data.overlap import scan_overlap
from fullturn.data.pair import Pair
from fullturn.data.random_sensor import random_sensor
from fullturn.data.sensor import Sensor
from fullturn.data.shapes import ProceduralShapes
from fullturn.errors import InputError
from fullturn.geometry.motion import move

SHAPES = ProceduralShapes(1000, seed=2)


def test_the_kinds_come_in_their_shares() -> None:
    pairs = MixedPairs(SHAPES, count=2000, seed=0)
    drawn = [pairs.group(i) for i in range(2000)]
    for kind, share in KINDS.items():
        assert drawn.count(kind) / 2000 == pytest.approx(share, abs=0.03)


def test_unrelated_pairs_say_so() -> None:
    pairs = MixedPairs(SHAPES, count=30, seed=1)
    kinds = [pairs.group(i) for i in range(30)]
    assert "unrelated" in kinds
    for index, kind in enumerate(kinds):
        if kind in ("unrelated", "noisy"):
            pair = pairs.pair(index)
            assert pair.related == (kind != "unrelated")
            assert np.array_equal(pair.T_target_source, np.eye(4)) == (kind == "unrelated")


def test_pairs_depend_on_seed_and_number_alone() -> None:
    few, many = (MixedPairs([SHAPES], count=count, seed=4) for count in (3, 9))
    direct = mixed_pair([SHAPES], seed=4, number=2)
    assert few.group(2) == direct.kind
    assert few.pair(2).source.tobytes() == many.pair(2).source.tobytes()
    assert few.pair(2).source.tobytes() == direct.pair.source.tobytes()
    assert direct.shape in few.pair(2).name


def test_scans_are_various() -> None:
    pairs = MixedPairs(SHAPES, count=150, seed=6)
    scans = [pairs.pair(i) for i in range(150) if pairs.group(i) == "scan"]
    overlaps, distances, evenness = [], [], []
    for pair in scans:
        assert pair.source_viewpoint is not None
        moved = move(pair.T_target_source, pair.source)
        overlaps.append(scan_overlap(moved, pair.target))
        center = (pair.source.min(axis=0) + pair.source.max(axis=0)) / 2
        distances.append(np.linalg.norm(pair.source_viewpoint - center))
        gaps = cKDTree(pair.source).query(pair.source, k=2)[0][:, 1]
        evenness.append(np.quantile(gaps, 0.05) / np.median(gaps))
    # Evenly over the range, but for thinning that comes on top.
    assert min(overlaps) < 0.5 < 0.8 < max(overlaps)
    assert max(np.histogram(overlaps, [0, 0.25, 0.5, 0.75, 1])[0]) < 0.5 * len(overlaps)
    assert min(np.quantile(overlaps, 0.4), 1 - np.quantile(overlaps, 0.6)) > 0.3
    # Up to a radius from the object's middle to the middle of what is seen of it.
    assert 0.7 < min(distances) < 2.0 < 3.5 < max(distances) < 6.0
    assert min(evenness) < 0.65 < 0.75 < max(evenness)


def test_shapes_whose_views_never_overlap_enough_still_give_a_pair(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scan_pair, asked = mixture.scan_pair, []

    def demanding(*args: Any, min_overlap: float, **options: Any) -> Pair:
        asked.append(min_overlap)
        if min_overlap > 0.0:
            raise InputError("expected views that overlap")
        return scan_pair(*args, min_overlap=min_overlap, **options)

    monkeypatch.setattr(mixture, "scan_pair", demanding)
    number = next(i for i in range(99) if MixedPairs(SHAPES, count=99).group(i) == "scan")
    assert len(mixed_pair([SHAPES], seed=0, number=number).pair.source) > 0
    assert len(asked) == 2
    assert asked[1] == 0.0 < asked[0]


def test_random_sensors_keep_to_their_ranges() -> None:
    sensors = [random_sensor(np.random.default_rng(i), distance=2.0) for i in range(600)]
    ideal = [s for s in sensors if s == Sensor()]
    noisy = [s for s in sensors if s.noise > 0.0 and s.grazing_deg == 0.0]
    real = [s for s in sensors if s.grazing_deg > 0.0]
    for part in (ideal, noisy, real):
        assert len(part) == pytest.approx(200, abs=50)
    for sensor in noisy + real:
        assert 0.002 <= 4.0 * sensor.noise <= 0.01
    for sensor in real:
        assert 0.001 <= 4.0 * sensor.quantize <= 0.008
        assert 10.0 <= sensor.grazing_deg <= 30.0
        assert 0.0 <= sensor.flying <= 0.3
    assert {sensor.holes for sensor in real} == {0, 1, 2, 3}


def test_two_shapes_are_needed() -> None:
    for shapes in (ProceduralShapes(1), []):
        with pytest.raises(InputError, match="two shapes"):
            MixedPairs(shapes, count=1)
