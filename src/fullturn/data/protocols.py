"""Benchmark protocols as data: each says how a shape becomes a pair of clouds with a true pose."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from fullturn.data.categories import AXISYMMETRIC_CLASSES, SEEN_CLASSES
from fullturn.data.motion import (
    axis_angle_rotation,
    ball_translation,
    euler_rotation,
    invert,
    move,
    rigid,
)
from fullturn.data.mvp_rg import MvpRgConfig
from fullturn.data.mvp_views import Viewer, in_unit_ball
from fullturn.data.pair import Pair
from fullturn.data.pair_set import PairSet, check_count
from fullturn.data.perturb import crop_nearest, crop_plane, far_viewpoint, jitter, resample
from fullturn.data.random_sensor import random_sensor
from fullturn.data.scanner import Seen
from fullturn.data.shapes import MeshSource, ShapeSource
from fullturn.data.view_pool import ViewPool
from fullturn.errors import InputError

_ROUNDING_DEG = 1e-6
_LATTICES = 4  # of cameras around a shape, each turned anew, before it counts as unfit


@dataclass(frozen=True)
class Protocol:
    """How pairs are drawn. Lengths are in radii of the unit ball."""

    name: str
    crop: Literal["far_viewpoint", "plane", "views"]
    resampled: bool  # two samples of the surface instead of one for both clouds
    max_angle_deg: float  # of the relative rotation: about one axis, or of each Euler angle
    noise_sigma: float = 0.0  # of every coordinate, after the crop
    noise_clip: float = 0.05
    sample_points: int = 1024  # of the whole object, before the crop; crop "views" takes none
    kept_share: float = 0.7  # of the points, on the kept side of a plane (crop "plane")
    cloud_points: int = 768  # of each cloud
    without_axisymmetric: bool = False  # leave the eight axisymmetric ModelNet40 classes out
    unseen: bool = False  # test on the last 20 ModelNet40 classes; the first 20 are for training
    least_overlap: float = 0.0  # share of each cloud that the other one sees, too (crop "views")
    # What sees the object: an ideal camera, or `random_sensor`, one a pair (crop "views").
    sensor: Literal["ideal", "random"] = "ideal"

    @property
    def stored_points(self) -> int:
        """How many points of a shape a pair takes, where shapes are stored samples."""
        twice = self.resampled and self.crop == "far_viewpoint"
        return self.sample_points * (2 if twice else 1)

    @property
    def rotation_limit_deg(self) -> float | None:
        """The largest angle of the relative rotation, None where all rotations are possible.

        Rx(α)·Ry(β)·Rz(γ) has the quaternion cos½α·cos½β·cos½γ − sin½α·sin½β·sin½γ, … The cosine of
        half its angle falls with each Euler angle from 0° up, so that the angle is largest where
        all three are: at 2·acos(cos³½m − sin³½m), which reaches 180° at m = 90°.

        >>> PROTOCOLS["modelnet40/noisy/45"].rotation_limit_deg
        45.0
        >>> round(PROTOCOLS["rpmnet/45"].rotation_limit_deg, 2)
        85.8
        """
        limit_deg = float(self.max_angle_deg)
        if self.crop == "plane":
            half_rad = math.radians(min(limit_deg, 90.0) / 2.0)
            cosine = math.cos(half_rad) ** 3 - math.sin(half_rad) ** 3
            limit_deg = 2.0 * math.degrees(math.acos(cosine))
        return limit_deg if limit_deg < 180.0 - _ROUNDING_DEG else None

    def allows(self, category: str) -> bool:
        """Whether the protocol tests on this category; unknown categories count as unseen."""
        if self.without_axisymmetric and category in AXISYMMETRIC_CLASSES:
            return False
        return not (self.unseen and category in SEEN_CLASSES)

    def eligible(self, shapes: ShapeSource) -> list[int]:
        """The shapes that the protocol tests on.

        Raises:
            InputError: none of them, or they can't give what the protocol needs.
        """
        if self.crop == "views":
            _meshes(self, shapes)
        stored = shapes.stored_points
        if stored is not None and stored < self.stored_points:
            raise InputError(
                f"{self.name} needs {self.stored_points:,} points of each shape; got shapes of "
                f"{stored:,} stored points; pass meshes or shapes with more points"
            )
        if not (self.unseen or self.without_axisymmetric):
            return list(range(len(shapes)))
        categories = [shapes.category(i) for i in range(len(shapes))]
        allowed = [i for i, category in enumerate(categories) if self.allows(category)]
        if not allowed:
            left_out = "the first 20 ModelNet40 classes" if self.unseen else ""
            if self.without_axisymmetric:
                left_out += " and the " if left_out else "the "
                left_out += "axisymmetric ones"
            raise InputError(
                f"{self.name} needs shapes outside {left_out}; got {len(shapes)} shapes of "
                f"{', '.join(sorted(set(categories)))}; pass other shapes"
            )
        return allowed


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
        return _views_pair(protocol, _meshes(protocol, shapes), index, rng, pool)
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


def _meshes(protocol: Protocol, shapes: ShapeSource) -> MeshSource:
    if not isinstance(shapes, MeshSource):
        raise InputError(
            f"{protocol.name} needs meshes, which a virtual camera can scan; got stored point "
            "samples; pass a mesh pack, a folder of meshes or procedural shapes"
        )
    return shapes


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


def _modelnet40(
    noise: Literal["clean", "noisy"], max_angle_deg: int, *, resampled: bool, unseen: bool
) -> Protocol:
    name = f"modelnet40/{noise}{'-resampled' if resampled else ''}/{max_angle_deg}"
    return Protocol(
        name=name + ("/unseen" if unseen else ""),
        crop="far_viewpoint",
        resampled=resampled,
        max_angle_deg=max_angle_deg,
        noise_sigma=0.01 if noise == "noisy" else 0.0,
        unseen=unseen,
    )


def _plane(
    name: str, max_angle_deg: float, kept_share: float, *, without_axisymmetric: bool, unseen: bool
) -> Protocol:
    return Protocol(
        name=name,
        crop="plane",
        resampled=True,
        max_angle_deg=max_angle_deg,
        noise_sigma=0.01,
        sample_points=2048,
        kept_share=kept_share,
        cloud_points=717,
        without_axisymmetric=without_axisymmetric,
        unseen=unseen,
    )


def _views(name: str, sensor: Literal["ideal", "random"]) -> Protocol:
    return Protocol(
        name=name,
        crop="views",
        resampled=True,
        max_angle_deg=180.0,
        cloud_points=2048,
        least_overlap=0.3,
        sensor=sensor,
    )


_ALL = [
    _modelnet40(noise, angle, resampled=resampled, unseen=unseen)
    for noise in ("clean", "noisy")
    for angle, resampled in ((180, False), (45, False), (180, True))
    for unseen in (False, True)
] + [
    _plane("geotransformer/180", 180.0, 0.7, without_axisymmetric=True, unseen=False),
    _plane("rpmnet/45", 45.0, 0.7, without_axisymmetric=False, unseen=True),
    _plane("predator/45", 45.0, 0.5, without_axisymmetric=False, unseen=True),
    _views("mvp-rg", "ideal"),
    _views("mvp-rg-sensor", "random"),
]
PROTOCOLS: dict[str, Protocol] = {protocol.name: protocol for protocol in _ALL}
