"""The pairs of a run by number: which shape, which protocol, which draw."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fullturn.data.categories import SEEN_CLASSES
from fullturn.data.draw import make_pair, view_rules
from fullturn.data.open import find, open_shapes
from fullturn.data.pair import Pair
from fullturn.data.protocols import PROTOCOLS, Protocol
from fullturn.data.shapes import MeshPack, MeshSource, ShapeSource
from fullturn.data.view_pool import ViewPool
from fullturn.errors import InputError
from fullturn.normalize import normalized_clouds
from fullturn.training.config import DataConfig, ShapesConfig, ValidationConfig

# Which shapes are held out doesn't depend on a run's seed: runs are compared on the same ones.
_HELD_OUT_SEED = 20_231
_STREAMS = {"training": 0, "validation": 1}
_REPLACEMENTS = 20  # shapes tried for one pair of views
_POOL_BYTES = 1 << 29  # of views that are kept, in each process that makes pairs


class RunPairs:
    """Pairs without end for training or for validation; pair i depends on the seed and i alone.

    Each place of shapes is gone through in a new random order in every round. The shapes for
    validation are never among those for training.
    """

    def __init__(
        self,
        data: DataConfig,
        validation: ValidationConfig,
        *,
        part: Literal["training", "validation"],
        folder: Path | None = None,
    ) -> None:
        """`folder` is where relative paths are looked for first. Nothing is read yet."""
        self._data, self._validation = data, validation
        self._part, self._folder = part, folder

    def __getstate__(self) -> dict[str, Any]:
        # Workers read the shapes themselves: they may be hundreds of megabytes.
        settings = ("_data", "_validation", "_part", "_folder")
        return {name: self.__dict__[name] for name in settings}

    def pair(self, number: int) -> Pair:
        if self._data.count is not None and self._part == "training":
            number %= self._data.count
        rng = np.random.default_rng([self._data.seed, number, _STREAMS[self._part]])
        place = int(rng.choice(len(self._places), p=self._shares))
        protocol = self._protocols[int(rng.integers(len(self._protocols)))]
        pair = self._made(protocol, place, number, rng)
        return pair if self._data.frame == "made" else in_frame_of_method(pair)

    def _made(self, protocol: Protocol, place: int, number: int, rng: np.random.Generator) -> Pair:
        """The pair of the shape whose turn it is; of a later one, if no two views of it overlap."""
        source, indices = self._places[place]
        order = indices[self._order(place, number // len(indices))]
        pool = self._pools.get((place, protocol.name))
        make = partial(make_pair, protocol, source, rng=rng, pool=pool)
        tries = _REPLACEMENTS if protocol.crop == "views" else 1
        *others, last = np.roll(order, -(number % len(indices)))[:tries].tolist()
        for index in others:
            with suppress(InputError):
                return make(index)
        return make(last)

    @property
    def count(self) -> int:
        """The number of different shapes."""
        return sum(len(indices) for _, indices in self._places)

    @property
    def description(self) -> list[dict[str, Any]]:
        """What the shapes are: file, hash, part, license; and how many of them are used."""
        return [
            {**source.description, "used": len(indices), "share": float(share)}
            for (source, indices), share in zip(self._places, self._shares, strict=True)
        ]

    def name(self, number: int) -> str:
        """The shape that pair `number` shows."""
        return self.pair(number).name

    @cached_property
    def _protocols(self) -> list[Protocol]:
        changes = {
            key: value
            for key in ("sample_points", "cloud_points")
            if (value := getattr(self._data, key)) is not None
        }
        return [replace(PROTOCOLS[name], **changes) for name in self._data.protocols]

    @cached_property
    def _pools(self) -> dict[tuple[int, str], ViewPool]:
        """Views of the shapes of each place, by each protocol that has any."""
        # Validation's pairs are made once.
        wanted = [
            (place, source, protocol)
            for place, (source, _) in enumerate(self._places)
            for protocol in self._protocols
            if protocol.crop == "views" and self._part == "training"
            if isinstance(source, MeshSource)
        ]
        return {
            (place, protocol.name): ViewPool(
                source,
                partial(view_rules, protocol),
                seed=(self._data.seed, place),
                most_bytes=_POOL_BYTES // len(wanted),
            )
            for place, source, protocol in wanted
        }

    @cached_property
    def _places(self) -> list[tuple[ShapeSource, np.ndarray]]:
        share = 0.0 if self._validation.shapes else self._validation.share
        places = []
        for config in self._configs:
            source = _open(config, self._folder)
            indices = self._allowed(source, config)
            if share > 0.0:
                turn = np.random.default_rng(_HELD_OUT_SEED).permutation(len(indices))
                out = max(1, round(share * len(indices)))
                part = turn[:out] if self._part == "validation" else turn[out:]
                indices = indices[np.sort(part)]
            if len(indices) == 0:
                raise InputError(
                    f"expected shapes for {self._part} in {config.path}, none are left of "
                    f"{len(source)}; name more shapes"
                )
            places.append((source, indices))
        return places

    @cached_property
    def _shares(self) -> np.ndarray:
        shares = [config.share for config in self._configs]
        return np.array(shares) / sum(shares)

    @property
    def _configs(self) -> tuple[ShapesConfig, ...]:
        own = self._part == "validation" and bool(self._validation.shapes)
        return self._validation.shapes if own else self._data.shapes

    def _allowed(self, source: ShapeSource, config: ShapesConfig) -> np.ndarray:
        # This says what shapes a protocol can't be drawn from.
        allowed = set.intersection(*(set(p.eligible(source)) for p in self._protocols))
        if self._data.classes == "seen":
            allowed = {i for i in allowed if source.category(i) in SEEN_CLASSES}
            if not allowed:
                raise InputError(
                    f'classes = "seen": expected shapes of the first 20 ModelNet40 classes in '
                    f'{config.path}, found none; name other shapes, or write classes = "all"'
                )
        return np.array(sorted(allowed), dtype=np.int64)

    def _order(self, place: int, turn: int) -> np.ndarray:
        return _permutation(self._data.seed, _STREAMS[self._part], place, turn, self._length(place))

    def _length(self, place: int) -> int:
        return len(self._places[place][1])


def in_frame_of_method(pair: Pair) -> Pair:
    """The pair as a method gets it: normalized clouds, the pose between these, no viewpoints."""
    source, target, frame = normalized_clouds(pair.source, pair.target)
    T_target_source = frame.normalize(pair.T_target_source)
    return Pair(source.points.numpy(), target.points.numpy(), T_target_source, pair.name)


@lru_cache(maxsize=32)
def _permutation(seed: int, stream: int, place: int, turn: int, length: int) -> np.ndarray:
    # Five numbers, where a pair's own generator has three: never the same one.
    return np.random.default_rng([seed, stream, place, turn, length]).permutation(length)


def _open(config: ShapesConfig, folder: Path | None) -> ShapeSource:
    path = config.path
    if folder is not None and (folder / path).exists():
        path = str(folder / path)
    if not config.sources:
        return open_shapes(path if config.part is None else f"{path}:{config.part}")
    place = find(path, expected="a mesh pack FILE.npz")
    if place.suffix.lower() != ".npz":
        raise InputError(
            f"expected a mesh pack (.npz) where sources are named, got {path}; leave them out"
        )
    return MeshPack(place, split=config.part, sources=config.sources)
