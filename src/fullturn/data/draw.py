"""Pairs drawn by a protocol: pose, crop and noise."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from fullturn.data.motion import axis_angle_rotation, ball_translation, euler_rotation
from fullturn.data.mvp_rg import MvpRgConfig
from fullturn.data.mvp_views import Viewer, in_unit_ball
from fullturn.data.pair import Pair
from fullturn.data.pair_set import PairSet, check_count
from fullturn.data.perturb import crop_nearest, crop_plane, far_viewpoint, jitter, resample
from fullturn.data.protocols import Protocol, require_meshes
from fullturn.data.random_sensor import random_sensor
from fullturn.data.scanner import Seen
from fullturn.data.shapes import MeshSource, ShapeSource
from fullturn.data.view_pool import ViewPool
from fullturn.errors import InputError
from fullturn.geometry.motion import invert, move, rigid

_LATTICES = 4  # of cameras around a shape, each turned anew, before it counts as unfit


class ProtocolPairs(PairSet):
    """`count` pairs of a protocol; pair i depends only on (seed, i) and the shapes, to the byte.

    Shapes are taken in one seeded random order, round and round, so all appear about equally often.
    Protocols that differ in the noise alone draw the same poses and crops.
    """

    def __init__(
        self, protocol: Protocol, shapes: ShapeSource, *, count: int, seed: int = 0
    ) -> None:
        """Raises InputError where the shapes can't serve the protocol."""
        self.name, self.protocol, self.shapes = protocol.name, protocol, shapes
        self._count, self._seed = check_count(count), seed
        self._order = np.random.default_rng(seed).permutation(protocol.eligible(shapes))

    @cached_property
    def description(self) -> dict[str, Any]:
        limit_deg = self.protocol.rotation_limit_deg
        return {
            "kind": "protocol",
            "protocol": dataclasses.asdict(self.protocol),
            "seed": self._seed,
            "count": self._count,
            "shapes": self.shapes.description,
            **({} if limit_deg is None else {"told_rotation_deg": limit_deg}),
        }

    def __len__(self) -> int:
        return self._count

    def pair(self, index: int) -> Pair:
        self._check_index(index)
        shape = int(self._order[index % len(self._order)])
        rng = np.random.default_rng([self._seed, index])
        return make_pair(self.protocol, self.shapes, shape, rng=rng)


def make_pair(
    protocol: Protocol,
    shapes: ShapeSource,
    index: int,
    *,
    rng: np.random.Generator,
    pool: ViewPool | None = None,
) -> Pair:
    """One pair of the shape `index`: pose, crop, noise, each by the protocol's rule.

    With a pool of views, made of the same shapes by `view_rules`, two of these are taken; without,
    new ones (crop "views").
    """
    if protocol.crop == "views":
        return _views_pair(protocol, require_meshes(protocol, shapes), index, rng, pool)
    draw = _far_viewpoint_pair if protocol.crop == "far_viewpoint" else _plane_pair
    source, target, T_target_source = draw(protocol, shapes, index, rng)
    if protocol.noise_sigma > 0.0:
        source = jitter(source, rng, sigma=protocol.noise_sigma, clip=protocol.noise_clip)
        target = jitter(target, rng, sigma=protocol.noise_sigma, clip=protocol.noise_clip)
    return Pair(
        source,
        target,
        T_target_source,
        shapes.name(index),
        max_rotation_deg=protocol.rotation_limit_deg,
    )


_Clouds = tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "m 3"], Float[np.ndarray, "4 4"]]


def _far_viewpoint_pair(
    protocol: Protocol, shapes: ShapeSource, index: int, rng: np.random.Generator
) -> _Clouds:
    """Both clouds are posed, then each keeps the points nearest to one far viewpoint."""
    if protocol.resampled:
        first, second = shapes.points_pair(index, protocol.sample_points, rng)
    else:
        first = second = shapes.points(index, protocol.sample_points, rng)
    T_source_object, T_target_source = _common_and_relative(protocol, rng)
    viewpoint = far_viewpoint(rng)
    clouds = [
        # The crop keeps the order of the sample, which would give the matches away.
        resample(
            crop_nearest(posed, viewpoint, keep=protocol.cloud_points),
            rng,
            count=protocol.cloud_points,
        )
        for posed in (
            move(T_source_object, first),
            move(T_target_source @ T_source_object, second),
        )
    ]
    return clouds[0], clouds[1], T_target_source


def _plane_pair(
    protocol: Protocol, shapes: ShapeSource, index: int, rng: np.random.Generator
) -> _Clouds:
    """Each cloud is cut by its own random plane and then sampled; the target stays as stored."""
    sample = shapes.points(index, protocol.sample_points, rng)
    T_target_source = rigid(
        euler_rotation(rng, max_angle_deg=protocol.max_angle_deg), rng.uniform(-0.5, 0.5, 3)
    )
    source, target = (
        resample(
            crop_plane(sample, rng, keep_share=protocol.kept_share),
            rng,
            count=protocol.cloud_points,
        )
        for _ in range(2)
    )
    return move(invert(T_target_source), source), target, T_target_source


def view_rules(protocol: Protocol, rng: np.random.Generator) -> MvpRgConfig:
    """How a protocol's views are made: as those of a built MVP-RG set, by its own sensor."""
    config = MvpRgConfig(points=protocol.cloud_points, min_overlap=protocol.least_overlap)
    if protocol.sensor == "ideal":
        return config
    return dataclasses.replace(config, sensor=random_sensor(rng, distance=config.distance))


def _views_pair(
    protocol: Protocol,
    shapes: MeshSource,
    index: int,
    rng: np.random.Generator,
    pool: ViewPool | None,
) -> Pair:
    """Two virtual scans of a mesh as those of a built MVP-RG set, then posed."""
    if pool is None:
        first, second = _new_views(protocol, shapes, index, rng)
    else:
        first, second = pool.two_views(index, rng)
    T_source_object, T_target_source = _common_and_relative(protocol, rng)
    T_target_object = T_target_source @ T_source_object
    return Pair(
        move(T_source_object, first.points),
        move(T_target_object, second.points),
        T_target_source,
        shapes.name(index),
        source_viewpoint=move(T_source_object, first.camera.center[None])[0],
        target_viewpoint=move(T_target_object, second.camera.center[None])[0],
        max_rotation_deg=protocol.rotation_limit_deg,
    )


def _new_views(
    protocol: Protocol, shapes: MeshSource, index: int, rng: np.random.Generator
) -> tuple[Seen, Seen]:
    config = view_rules(protocol, rng)
    viewer = Viewer(in_unit_ball(shapes.raw_mesh(index)), config, rng)
    for _ in range(_LATTICES):
        found = viewer.two_views()
        if found is not None:
            return found[0], found[1]
    raise InputError(
        f"expected two views of {shapes.name(index)} with {protocol.cloud_points} points that "
        f"overlap by {protocol.least_overlap}, found none from {_LATTICES} times {config.views} "
        "sides; leave the shape out, or lower least_overlap or cloud_points"
    )


def _common_and_relative(
    protocol: Protocol, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "4 4"]]:
    """T_source_object, a pose common to both clouds, and T_target_source."""
    T_source_object = rigid(
        axis_angle_rotation(rng, max_angle_deg=180.0), ball_translation(rng, max_length=0.5)
    )
    T_target_source = rigid(
        axis_angle_rotation(rng, max_angle_deg=protocol.max_angle_deg),
        ball_translation(rng, max_length=0.25),
    )
    return T_source_object, T_target_source
