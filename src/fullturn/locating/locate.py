"""The front door: a model and a scene in, poses with probabilities out."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fullturn.errors import InputError, is_number, whole_number
from fullturn.geometry import rigid
from fullturn.geometry.extent import center_and_radius, strays
from fullturn.io import LoadedCloud, load_cloud
from fullturn.io.check import as_viewpoint
from fullturn.locating.candidates import Candidates, candidates, grid_of
from fullturn.locating.judge import Judged, judge
from fullturn.locating.model import PreparedModel, prepare
from fullturn.locating.result import Located, Location, OtherPose
from fullturn.locating.scene import SceneParts, free_parts, take_apart
from fullturn.locating.search import LocateConfig
from fullturn.locating.store import SUFFIX, load_prepared
from fullturn.normalize import Normalization
from fullturn.pose.grid import NearestGrid
from fullturn.threads import torch_threads

_UNLIKE = 30.0  # times as large as the model, or as small: worth a word
_COARSE = 0.3  # of the radius: points farther apart show nothing of a model
_FEWEST = 20  # points of a scene
_LEAST_PROBABILITY = 0.01  # of an alternative
_MOST_ALTERNATIVES = 9
# The probabilities were fit on parts of a few hundred points. Of fewer than this, little is known,
# and they are at most so large.
_KNOWN_POINTS, _UNKNOWN = 40, 0.2
# Spacings around a located model within which points are no other instance's: wider than what
# counts as lying on it (`verify.ON_MODEL`), so that no rim of it is left to be searched again.
_IN_ONE_PLACE = 0.05  # of the diameter: so near, half of a surface lies on another one
_TAKEN = 2.5


@torch_threads(1)
@torch.inference_mode()
def locate(
    model: Any,
    scene: Any,
    *,
    scene_viewpoint: Any = None,
    instances: int | None = 1,
    min_probability: float = 0.5,
    config: LocateConfig | None = None,
) -> Located:
    """Find where a known model stands in a partial scan, and how probably it is there.

    `model` is a `PreparedModel`, a file of one (.safetensors), or what `prepare` takes: a mesh or
    a complete cloud. The scene is a file path, an (N, 3) array, list or tensor, or an object with
    `.points`; it has the model's unit, and may hold more than the model: a table, other objects.
    `scene_viewpoint` (3,) says where the sensor stood, in the scene's frame; what it must have seen
    then counts. `instances` is how many are looked for at most, None: as many as there are. Beyond
    the first, each has a `surface_probability` of at least `min_probability`.

    Raises:
        InputError: a model, scene or viewpoint that cannot be used.
        ReadError: a file that cannot be read.
    """
    begin = time.perf_counter()
    most = None if instances is None else whole_number(instances, "instances", least=1)
    if not is_number(min_probability) or not 0.0 <= min_probability <= 1.0:
        raise InputError(f"min_probability: expected a number from 0 to 1, got {min_probability!r}")
    eye = as_viewpoint(scene_viewpoint, "scene_viewpoint", frame="scene's")
    cloud = load_cloud(scene, name=_role(scene))
    loaded = time.perf_counter()
    prepared = _prepared(model)
    ready = time.perf_counter()
    center, _ = center_and_radius(cloud.points)
    frame = Normalization(prepared.center.numpy(force=True), center, prepared.radius)
    points = torch.from_numpy((cloud.points - center) / prepared.radius)
    viewpoint = None if eye is None else torch.from_numpy((eye - center) / prepared.radius)
    parts = take_apart(points, viewpoint, prepared)
    notes = (*prepared.notes, *cloud.notes, *_size_notes(points, prepared))
    _check_scene(parts, points, prepared, cloud.name)
    taken_apart = time.perf_counter()
    search = _Search(parts, prepared, config or LocateConfig())
    found: list[Location] = []
    for place in search.places():
        if found and place.judged.surface[0] < min_probability:
            break
        if not search.is_new(place):
            continue
        found.append(_location(place, frame))
        if len(found) == most:
            break
    if not found:
        raise InputError(
            f"{cloud.name}: expected a surface of at least {_FEWEST} points that hang together, "
            f"found none among {len(cloud.points)}; give a denser scan"
        )
    end = time.perf_counter()
    seconds = {
        "check": loaded - begin,
        "prepare": ready - loaded,
        "take apart": taken_apart - ready,
        "search": end - taken_apart,
        "total": end - begin,
    }
    found.sort(key=lambda place: place.surface_probability, reverse=True)
    return Located(tuple(found), seconds, notes)


@dataclass(frozen=True, eq=False)
class _Place:
    """The poses of one part, judged."""

    found: Candidates
    judged: Judged


@dataclass(eq=False)
class _Search:
    """Finds one instance after the other; what is found of a part is kept while it stays."""

    scene: SceneParts
    model: PreparedModel
    config: LocateConfig
    _known: dict[bytes, _Place] = field(default_factory=dict)
    _poses: list[Tensor] = field(default_factory=list)

    @cached_property
    def _grid(self) -> NearestGrid:
        return grid_of(self.model)

    def places(self) -> Iterator[_Place]:
        """The most probable place; then that among the points that it leaves free.

        Parts are looked at from the largest on; where the model surely is in one, no others are.
        """
        free = torch.ones(len(self.scene.points), dtype=torch.bool, device=self.scene.points.device)
        while True:
            parts = free_parts(self.scene, free, self.model, limit=self.config.parts)
            best: _Place | None = None
            for members in parts:
                place = self._place(members)
                if best is None or place.judged.surface[0] > best.judged.surface[0]:
                    best = place
                if best.judged.surface[0] >= self.config.sure:
                    break
            if best is None:
                return
            yield best
            taken = self._taken(best)
            if not bool((free & taken).any()):
                return
            free &= ~taken

    def _place(self, members: Tensor) -> _Place:
        key = members.numpy(force=True).tobytes()
        if key not in self._known:
            found = candidates(self.scene, members, self.model, self._grid, self.config)
            T = found.T_scene_model.float()
            judged = judge(T, found.features, found.explained, self.model, self._grid)
            # On a large plane, any flat face of the model fits anywhere.
            if int((members & self.scene.off_planes).sum()) < _KNOWN_POINTS:
                judged = judged.at_most(_UNKNOWN)
            self._known[key] = _Place(found, judged)
        return self._known[key]

    def is_new(self, place: _Place) -> bool:
        """Whether no model lies where this one does: two can't be in one place.

        Noise wider than the spacing leaves points of a model that was found already.
        """
        T = place.found.T_scene_model[place.judged.index[0]].double()
        surface = self.model.surface.double()
        within = _IN_ONE_PLACE * self.model.diameter / self.model.radius
        for earlier in self._poses:
            at = rigid.apply(rigid.invert(earlier) @ T, surface).float()
            if float((self._grid.difference(at.T).norm(dim=0) < within).double().mean()) > 0.5:
                return False
        self._poses.append(T)
        return True

    def _taken(self, place: _Place) -> Tensor:
        T = place.found.T_scene_model[place.judged.index[0]]
        there = rigid.apply(rigid.invert(T), self.scene.points).float()
        difference = self._grid.difference(there.T)
        return difference.norm(dim=0) < _TAKEN * self.scene.spacing


def _location(place: _Place, frame: Normalization) -> Location:
    judged, found = place.judged, place.found
    T_scene_model = found.T_scene_model.numpy(force=True)
    kept = [
        OtherPose(frame.denormalize(T_scene_model[index]), pose, surface)
        for rank, (index, pose, surface) in enumerate(
            zip(judged.index, judged.pose, judged.surface, strict=True)
        )
        if rank == 0 or pose >= _LEAST_PROBABILITY
    ][: 1 + _MOST_ALTERNATIVES]
    best = judged.index[0]
    return Location(
        T_scene_model=kept[0].T_scene_model,
        success_probability=kept[0].success_probability,
        surface_probability=kept[0].surface_probability,
        visible_share=float(found.visible_share[best]),
        points=int(found.explained[best].sum()),
        alternatives=tuple(kept[1:]),
    )


def _prepared(model: Any) -> PreparedModel:
    if isinstance(model, PreparedModel):
        return model
    if isinstance(model, (str, os.PathLike)) and Path(model).suffix.lower() == SUFFIX:
        return load_prepared(model)
    return prepare(model)


def _role(scene: Any) -> str | None:
    return None if isinstance(scene, (str, os.PathLike, LoadedCloud)) else "scene"


def _size_notes(points: Tensor, model: PreparedModel) -> tuple[str, ...]:
    values = points.numpy(force=True)
    size = float(np.linalg.norm(np.ptp(values[~strays(values)], axis=0)))
    ratio = size / (model.diameter / model.radius)
    if 1.0 / _UNLIKE < ratio < _UNLIKE:
        return ()
    return (f"the scene is {ratio:.3g} times as large as the model: is the unit the same?",)


def _check_scene(scene: SceneParts, points: Tensor, model: PreparedModel, name: str) -> None:
    """Whether the scene can show a model of this size at all."""
    if len(scene.points) >= _FEWEST and scene.spacing < _COARSE:
        return
    size = float((points.amax(0) - points.amin(0)).norm()) * model.radius
    raise InputError(
        f"{name}: expected at least {_FEWEST} points on a model with a diameter of "
        f"{model.diameter:.3g}; the scene, {size:.3g} across, has {len(scene.points)} that are "
        f"about {scene.spacing * model.radius:.3g} apart, of {len(points)}: is the unit the same? "
        "If it is, give a denser scan"
    )
