"""Benchmark protocols as data: each says how a shape becomes a pair of clouds with a true pose."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from fullturn.data.motion import (
    axis_angle_rotation,
    ball_translation,
    euler_rotation,
    invert,
    move,
    rigid,
)
from fullturn.data.pair import Pair
from fullturn.data.perturb import crop_nearest, crop_plane, far_viewpoint, jitter, resample
from fullturn.data.shapes import ShapeSource
from fullturn.errors import InputError

# fmt: off
MODELNET40_CLASSES = (  # in the order of their labels, 0 to 39
    "airplane", "bathtub", "bed", "bench", "bookshelf", "bottle", "bowl", "car",
    "chair", "cone", "cup", "curtain", "desk", "door", "dresser", "flower_pot",
    "glass_box", "guitar", "keyboard", "lamp", "laptop", "mantel", "monitor", "night_stand",
    "person", "piano", "plant", "radio", "range_hood", "sink", "sofa", "stairs",
    "stool", "table", "tent", "toilet", "tv_stand", "vase", "wardrobe", "xbox",
)
# fmt: on
AXISYMMETRIC_CLASSES = frozenset(
    ("bottle", "bowl", "cone", "cup", "flower_pot", "lamp", "tent", "vase")
)
SEEN_CLASSES = frozenset(MODELNET40_CLASSES[:20])


@dataclass(frozen=True)
class Protocol:
    """How pairs are drawn. Lengths are in radii of the unit ball."""

    name: str
    crop: Literal["far_viewpoint", "plane"]
    resampled: bool  # two samples of the surface instead of one for both clouds
    max_angle_deg: float  # of the relative rotation: about one axis, or of each Euler angle
    noise_sigma: float = 0.0  # of every coordinate, after the crop
    noise_clip: float = 0.05
    sample_points: int = 1024  # of the whole object, before the crop
    kept_share: float = 0.7  # of the points, on the kept side of a plane (crop "plane")
    cloud_points: int = 768  # of each cloud
    without_axisymmetric: bool = False  # leave the eight axisymmetric ModelNet40 classes out
    unseen: bool = False  # test on the last 20 ModelNet40 classes; the first 20 are for training


def make_pairs(
    protocol: Protocol, shapes: ShapeSource, *, count: int, seed: int = 0
) -> Iterator[Pair]:
    """Yield `count` pairs; pair i depends only on (seed, i) and the shapes, to the byte.

    Shapes are taken in one seeded random order, round and round, so all appear about equally often.
    Protocols that differ in the noise alone draw the same poses and crops.
    """
    eligible = list(range(len(shapes)))
    # A category may cost the making of its shape: asked only where the protocol cares.
    if protocol.unseen or protocol.without_axisymmetric:
        eligible = [i for i in eligible if is_eligible(protocol, shapes.category(i))]
    if not eligible:
        raise InputError(
            f"expected shapes that {protocol.name} allows, got {len(shapes)} of other categories; "
            "pass other shapes"
        )
    order = np.random.default_rng(seed).permutation(eligible)
    for i in range(count):
        yield make_pair(
            protocol, shapes, int(order[i % len(order)]), rng=np.random.default_rng([seed, i])
        )


def is_eligible(protocol: Protocol, category: str) -> bool:
    """Whether the protocol tests on this category; unknown categories count as unseen."""
    if protocol.without_axisymmetric and category in AXISYMMETRIC_CLASSES:
        return False
    return not (protocol.unseen and category in SEEN_CLASSES)


def make_pair(
    protocol: Protocol, shapes: ShapeSource, index: int, *, rng: np.random.Generator
) -> Pair:
    """One pair of the shape `index`: pose, crop, noise, each by the protocol's rule."""
    draw = _far_viewpoint_pair if protocol.crop == "far_viewpoint" else _plane_pair
    source, target, T_target_source = draw(protocol, shapes, index, rng)
    if protocol.noise_sigma > 0.0:
        source = jitter(source, rng, sigma=protocol.noise_sigma, clip=protocol.noise_clip)
        target = jitter(target, rng, sigma=protocol.noise_sigma, clip=protocol.noise_clip)
    return Pair(source, target, T_target_source, shapes.name(index))


_Clouds = tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "m 3"], Float[np.ndarray, "4 4"]]


def _far_viewpoint_pair(
    protocol: Protocol, shapes: ShapeSource, index: int, rng: np.random.Generator
) -> _Clouds:
    """Both clouds are posed, then each keeps the points nearest to one far viewpoint."""
    if protocol.resampled:
        first, second = shapes.points_pair(index, protocol.sample_points, rng)
    else:
        first = second = shapes.points(index, protocol.sample_points, rng)
    T_source_object = rigid(
        axis_angle_rotation(rng, max_angle_deg=180.0), ball_translation(rng, max_length=0.5)
    )
    T_target_source = rigid(
        axis_angle_rotation(rng, max_angle_deg=protocol.max_angle_deg),
        ball_translation(rng, max_length=0.25),
    )
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


_ALL = [
    _modelnet40(noise, angle, resampled=resampled, unseen=unseen)
    for noise in ("clean", "noisy")
    for angle, resampled in ((180, False), (45, False), (180, True))
    for unseen in (False, True)
] + [
    _plane("geotransformer/180", 180.0, 0.7, without_axisymmetric=True, unseen=False),
    _plane("rpmnet/45", 45.0, 0.7, without_axisymmetric=False, unseen=True),
    _plane("predator/45", 45.0, 0.5, without_axisymmetric=False, unseen=True),
]
PROTOCOLS: dict[str, Protocol] = {protocol.name: protocol for protocol in _ALL}
