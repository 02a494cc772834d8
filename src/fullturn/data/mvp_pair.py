"""One pair of a built MVP-RG set: an object, two of its views, a random motion of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from fullturn.data.motion import axis_angle_rotation, ball_translation, uniform_rotation
from fullturn.data.mvp_rg import SPLITS, MvpRgConfig
from fullturn.data.mvp_shapes import Shape, schedule, split_shapes
from fullturn.data.mvp_views import Viewer, in_unit_ball
from fullturn.data.scanner import Seen
from fullturn.data.shapes import MeshSource
from fullturn.errors import FullturnError, InputError
from fullturn.geometry.motion import invert, move, rigid

NOT_READ, NO_SURFACE = "mesh that cannot be read", "mesh without a usable surface"
EMPTY_VIEW, APART = "view that shows too little", "object without two views that overlap enough"

_ATTEMPTS = 20  # objects tried for one pair
_ANY_ROTATION_SHARE = 0.2  # of the released set
_SMALL_TURN_DEG = 45.0


class Task(NamedTuple):
    """A pair by its number in a split."""

    split: str
    number: int


class Skip(NamedTuple):
    """What was left out on the way to a pair, and why."""

    number: int  # of the pair
    shape: str
    reason: str


@dataclass(frozen=True, eq=False)
class MadePair:
    """A pair as it is stored, and what was left out for it."""

    source: Float[np.ndarray, "n 3"]  # float32
    target: Float[np.ndarray, "n 3"]  # float32
    T_target_source: Float[np.ndarray, "4 4"]
    source_viewpoint: Float[np.ndarray, "3"]
    target_viewpoint: Float[np.ndarray, "3"]
    name: str
    category: str
    overlap: float
    match_level: int
    rotation_level: int
    skips: tuple[Skip, ...] = ()


class PairMaker:
    """Makes pairs by number: pair i of a split depends on the rules, the shapes and i alone.

    It pickles. An object that gives no pair is replaced by another one of the split, drawn at
    random.
    """

    def __init__(
        self,
        config: MvpRgConfig,
        sources: Sequence[MeshSource],
        tests: Sequence[MeshSource] = (),
    ) -> None:
        self._config, self._sources = config, (*sources, *tests)
        self.shapes = split_shapes(sources, tests, config)
        self._schedules = {
            split: schedule(self.shapes[split], config.count(split))
            for split in SPLITS
            if config.count(split)
        }

    def __call__(self, task: Task) -> MadePair | FullturnError:
        """The pair; an error where no object gives one."""
        pool = self.shapes[task.split]
        skips: list[Skip] = []
        for attempt in range(_ATTEMPTS):
            rng = np.random.default_rng(
                [self._config.seed, SPLITS.index(task.split), task.number, attempt]
            )
            another = pool[rng.integers(len(pool))]
            shape = another if attempt else self._schedules[task.split][task.number]
            made, reasons = self._try(shape, rng)
            skips += [Skip(task.number, shape.name, reason) for reason in reasons]
            if made is not None:
                return replace(made, skips=tuple(skips))
        return InputError(
            f"expected shapes that give pairs, found none in {_ATTEMPTS} tries for pair "
            f"{task.number} of {task.split}: {', '.join(sorted({skip.reason for skip in skips}))}; "
            "check the shapes, or lower min_overlap"
        )

    def _try(self, shape: Shape, rng: np.random.Generator) -> tuple[MadePair | None, list[str]]:
        """A pair of this object, if it gives one, and the reasons for what was left out."""
        try:
            mesh = self._sources[shape.source].raw_mesh(shape.number)
        # A damaged file fails as whatever the reader of its format raises.
        except Exception:
            return None, [NOT_READ]
        try:
            viewer = Viewer(in_unit_ball(mesh), self._config, rng)
        except InputError:
            return None, [NO_SURFACE]
        views = viewer.two_views()
        empty = [EMPTY_VIEW] * viewer.empty
        if views is None:
            return None, [*empty, APART]
        return self._moved(shape, *views, rng), empty

    def _moved(
        self, shape: Shape, first: Seen, second: Seen, overlap: float, rng: np.random.Generator
    ) -> MadePair:
        """The pair of two views, each under its own motion."""
        config = self._config
        rotation_level = int(config.rotation == "full" or rng.random() < _ANY_ROTATION_SHARE)
        R_source = uniform_rotation(rng)
        R_target = (
            uniform_rotation(rng)
            if rotation_level
            else axis_angle_rotation(rng, max_angle_deg=_SMALL_TURN_DEG) @ R_source
        )
        T_source_object, T_target_object = (
            rigid(R, ball_translation(rng, max_length=config.translation))
            for R in (R_source, R_target)
        )
        return MadePair(
            move(T_source_object, first.points).astype(np.float32),
            move(T_target_object, second.points).astype(np.float32),
            T_target_object @ invert(T_source_object),
            move(T_source_object, first.camera.center[None])[0],
            move(T_target_object, second.camera.center[None])[0],
            shape.name,
            shape.category,
            overlap,
            int(overlap >= config.high_overlap),
            rotation_level,
        )
