"""Pairs of many kinds at once: what a method that judges itself has to have seen."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from contextlib import suppress
from functools import cached_property, partial
from typing import Any

import numpy as np
from jaxtyping import Float

from fullturn.data.draw import make_pair
from fullturn.data.motion import uniform_direction
from fullturn.data.pair import Pair
from fullturn.data.pair_set import PairSet, check_count
from fullturn.data.protocols import PROTOCOLS
from fullturn.data.random_sensor import random_sensor
from fullturn.data.scan import scan_pair
from fullturn.data.shapes import MeshSource
from fullturn.data.solids import to_unit_ball
from fullturn.errors import InputError

KINDS = {  # name: share of the pairs
    "noisy": 0.15,
    "clean": 0.05,
    "noisy-resampled": 0.16,
    "clean-resampled": 0.08,
    "plane": 0.18,
    "scan": 0.26,
    "unrelated": 0.12,
}

_UNEVEN = 0.3  # share of the pairs whose clouds are thinned unevenly
_LEAST_POINTS = 12
_DISTANCES = (1.5, 5.0)  # of the eyes of scans, in radii
# Overlaps of scans are drawn evenly: views from random sides mostly overlap by more than half.
_LEAST_OVERLAPS, _OVERLAP_STEP = (0.1, 0.75), 0.2
_NEARER = 1.25  # by so much, at most, is one of two eyes nearer or farther than their mean


@dataclasses.dataclass(frozen=True, eq=False)
class MixedPair:
    """A pair, which kind it is of, and the shape that it shows (for splits by shape)."""

    pair: Pair
    kind: str  # a key of KINDS
    shape: str


class MixedPairs(PairSet):
    """`count` pairs of a mixture of kinds; pair i depends only on (seed, i) and the shapes.

    The group of a pair is its kind.
    """

    name = "mixture"

    def __init__(
        self, shapes: MeshSource | Sequence[MeshSource], *, count: int, seed: int = 0
    ) -> None:
        self._shapes = [shapes] if isinstance(shapes, MeshSource) else list(shapes)
        if not self._shapes or min(len(source) for source in self._shapes) < 2:
            raise InputError(
                "expected at least one source of meshes, and two shapes in each, for the pairs of "
                "different objects; pass more shapes"
            )
        self._count, self._seed = check_count(count), seed

    @cached_property
    def description(self) -> dict[str, Any]:
        return {
            "kind": "mixture",
            "kinds": KINDS,
            "seed": self._seed,
            "count": self._count,
            "shapes": [source.description for source in self._shapes],
        }

    def __len__(self) -> int:
        return self._count

    def pair(self, index: int) -> Pair:
        self._check_index(index)
        return mixed_pair(self._shapes, seed=self._seed, number=index).pair

    def group(self, index: int) -> str:
        self._check_index(index)
        return _choose(self._shapes, np.random.default_rng([self._seed, index]))[2]


def mixed_pair(
    shapes: Sequence[MeshSource], *, seed: int, number: int, dense: bool = False
) -> MixedPair:
    """Pair `number` of a mixture that depends on (seed, number) and the shapes alone.

    One sampling or two, noise or none, half-space and plane crops, virtual scans, from a dozen to
    thousands of points, and two different shapes that don't belong together. `dense` clouds have
    5,000 to 40,000 points (scans to 8,000), as scanners give.
    """
    rng = np.random.default_rng([seed, number])
    source, index, kind = _choose(shapes, rng)
    if kind != "unrelated":
        return MixedPair(_draw(source, index, kind, rng, dense), kind, source.name(index))
    kinds = [k for k in KINDS if k != "unrelated"]
    first = _draw(source, index, str(rng.choice(kinds)), rng, dense)
    other = (index + 1 + int(rng.integers(len(source) - 1))) % len(source)
    second = _draw(source, other, str(rng.choice(kinds)), rng, dense)
    unrelated = dataclasses.replace(
        first,
        target=second.target,
        target_viewpoint=second.target_viewpoint,
        T_target_source=np.eye(4),
        name=f"{first.name} + {second.name}",
        related=False,
    )
    return MixedPair(unrelated, kind, source.name(index))


def _choose(shapes: Sequence[MeshSource], rng: np.random.Generator) -> tuple[MeshSource, int, str]:
    """The source, the number of the shape in it, and the kind of the pair."""
    source = shapes[int(rng.integers(len(shapes)))]
    index = int(rng.integers(len(source)))
    return source, index, str(rng.choice(list(KINDS), p=list(KINDS.values())))


def _draw(source: MeshSource, index: int, kind: str, rng: np.random.Generator, dense: bool) -> Pair:
    pair = _draw_even(source, index, kind, rng, dense)
    if rng.random() >= _UNEVEN:
        return pair
    return dataclasses.replace(
        pair, source=_uneven(pair.source, rng), target=_uneven(pair.target, rng)
    )


def _uneven(points: Float[np.ndarray, "n 3"], rng: np.random.Generator) -> np.ndarray:
    """Thinner overall by up to 4, or by up to 8 towards one side, as far from a sensor."""
    if rng.random() < 0.5:
        kept = rng.random(len(points)) < rng.uniform(0.25, 1.0)
    else:
        along = points @ uniform_direction(rng)
        position = (along - along.min()) / max(float(np.ptp(along)), 1e-12)
        kept = rng.random(len(points)) < rng.uniform(2.0, 8.0) ** -position
    return points[kept] if kept.sum() >= _LEAST_POINTS else points


def _draw_even(
    source: MeshSource, index: int, kind: str, rng: np.random.Generator, dense: bool
) -> Pair:
    many = int(np.exp(rng.uniform(np.log(5_000), np.log(40_000)))) if dense else 0
    if kind == "scan":
        points = min(many, 8_000) or _scan_points(rng)
        return _scans(source, index, rng, points)
    sigma = float(rng.choice([0.005, 0.01, 0.01, 0.015]))
    few = int(np.exp(rng.uniform(np.log(12), np.log(400))))
    if kind == "plane":
        protocol = PROTOCOLS["geotransformer/180"]
        kept_share = float(rng.uniform(0.45, 0.8))
        drawn = int(rng.integers(300, 800)) if rng.random() < 0.85 else few
        protocol = dataclasses.replace(
            protocol,
            kept_share=kept_share,
            sample_points=many or protocol.sample_points,
            cloud_points=many // 3 or drawn,
            noise_sigma=sigma if rng.random() < 0.8 else 0.0,
        )
    else:
        points = many or int(rng.choice([few, 512, 1024, 1024, 1024, 2048, 4096]))
        protocol = dataclasses.replace(
            PROTOCOLS[f"modelnet40/{kind}/180"],
            sample_points=points,
            cloud_points=points * 3 // 4,
            noise_sigma=sigma if kind.startswith("noisy") else 0.0,
        )
    return make_pair(protocol, source, index, rng=rng)


def _scans(source: MeshSource, index: int, rng: np.random.Generator, points: int) -> Pair:
    """Two views by one sensor, from about one distance."""
    nearest, farthest = _DISTANCES
    distance = rng.uniform(nearest, farthest)
    mesh, overlap = to_unit_ball(source.raw_mesh(index)), rng.uniform(*_LEAST_OVERLAPS)
    sensor = random_sensor(rng, distance=distance)
    scan = partial(
        scan_pair,
        mesh,
        rng,
        points=points,
        distance=(max(distance / _NEARER, nearest), min(distance * _NEARER, farthest)),
        sensor=sensor,
        thinning="farthest" if rng.random() < 0.5 else "random",
        name=source.name(index),
    )
    # Some shapes overlap in no such way, lattices and wires never much; any two views will do.
    with suppress(InputError):
        return scan(min_overlap=overlap, max_overlap=overlap + _OVERLAP_STEP)
    return scan(min_overlap=0.0)


def _scan_points(rng: np.random.Generator) -> int:
    return int(rng.integers(500, 3000) if rng.random() < 0.85 else rng.integers(60, 500))
