"""Views of meshes that are made once and kept, for pairs that are drawn over and over."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import trimesh

from fullturn.data.mvp_rg import MvpRgConfig
from fullturn.data.mvp_views import cameras_of, in_unit_ball, view_of, within_reach
from fullturn.data.overlap import scan_overlap
from fullturn.data.scanner import Scanner, Seen
from fullturn.data.shapes import MeshSource
from fullturn.errors import InputError

Rules = Callable[[np.random.Generator], MvpRgConfig]

_VIEWS = 12  # of a mesh, out of the lattice: about 33 pairs overlap enough
_FLOATS = 4  # bytes of a coordinate
_REST = 1024  # bytes a view, about: its camera, its overlaps with the others
_CAMERAS, _VIEW = 1, 2  # what random numbers are for


class ViewPool:
    """Some views of each mesh, and two of them at random that overlap enough.

    The views are those of a built MVP-RG set, rounded to single precision; which ones a mesh has
    depends on the words of `seed`, the rules and its number alone, and two of them on the random
    numbers, too: never on what was asked for before. A view is made when it is first needed. Those
    of the first meshes are kept, up to `most_bytes`; those of others are made at every call. (In
    rounds through more meshes than there is room for, the oldest would go before their turn.)
    """

    def __init__(
        self,
        shapes: MeshSource,
        rules: Rules,
        *,
        seed: Sequence[int],
        most_bytes: int,
        views: int = _VIEWS,
    ) -> None:
        """`rules` says what a mesh's views are like, by its random numbers (for its sensor)."""
        self._shapes, self._rules, self._seed = shapes, rules, tuple(seed)
        self._views, self._most_bytes = views, most_bytes
        self._kept: dict[int, _MeshViews] = {}
        self._room = most_bytes

    @property
    def kept_bytes(self) -> int:
        """Memory for all views of the meshes that are kept, made or not."""
        return self._most_bytes - self._room

    def two_views(self, index: int, rng: np.random.Generator) -> tuple[Seen, Seen]:
        """Two views of a mesh.

        Raises:
            InputError: no two of its views overlap enough, or it has no usable surface.
        """
        views = self._kept.get(index)
        if views is None:
            views = _MeshViews(self._rules, self._views, (*self._seed, index))
            if views.bytes <= self._room:
                self._kept[index] = views
                self._room -= views.bytes
        found = views.two(lambda: self._shapes.raw_mesh(index), rng)
        if found is None:
            raise InputError(
                f"expected two out of {self._views} views of {self._shapes.name(index)} that have "
                f"{views.config.points} points and overlap by {views.config.min_overlap}, found "
                "none; leave the shape out, or ask for less"
            )
        return found


class _MeshViews:
    """The views of one mesh from some of the cameras around it, as far as they were needed."""

    def __init__(self, rules: Rules, count: int, seed: tuple[int, ...]) -> None:
        rng = np.random.default_rng([*seed, 0, _CAMERAS])
        self.config = config = rules(rng)
        cameras = cameras_of(config, rng)
        self._seed = seed
        self._cameras = [cameras[number] for number in rng.permutation(len(cameras))[:count]]
        self._seen: dict[int, Seen | None] = {}
        self._overlap = np.full((count, count), np.nan)

    @property
    def bytes(self) -> int:
        """Memory for all of them."""
        return len(self._cameras) * (3 * _FLOATS * self.config.points + _REST)

    def two(
        self, mesh: Callable[[], trimesh.Trimesh], rng: np.random.Generator
    ) -> tuple[Seen, Seen] | None:
        """Two that overlap enough: the first that do, in random order."""
        scanner: Scanner | None = None
        for pair in self._in_reach(rng.permutation(len(self._cameras)).tolist()):
            for number in pair:
                if number not in self._seen:
                    if scanner is None:
                        scanner = Scanner(
                            in_unit_ball(mesh()), sensor=self.config.sensor, radius=1.0
                        )
                    self._seen[number] = self._look(scanner, number)
            first, second = (self._seen[number] for number in pair)
            if first is None or second is None:
                continue
            key = (min(pair), max(pair))
            if np.isnan(self._overlap[key]):
                self._overlap[key] = scan_overlap(first.points, second.points)
            if self._overlap[key] >= self.config.min_overlap:
                return _double(first), _double(second)
        return None

    def _in_reach(self, order: Sequence[int]) -> Iterator[tuple[int, int]]:
        for first in order:
            for second in order:
                if first != second and within_reach(self._cameras[first], self._cameras[second]):
                    yield first, second

    def _look(self, scanner: Scanner, number: int) -> Seen | None:
        rng = np.random.default_rng([*self._seed, number, _VIEW])
        seen = view_of(scanner, self._cameras[number], self.config, rng)
        return None if seen is None else Seen(seen.points.astype(np.float32), seen.camera)


def _double(seen: Seen) -> Seen:
    return Seen(seen.points.astype(np.float64), seen.camera)
