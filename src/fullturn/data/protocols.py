"""Benchmark protocols as data: each says how a shape becomes a pair of clouds with a true pose."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from fullturn.data.categories import AXISYMMETRIC_CLASSES, SEEN_CLASSES
from fullturn.data.shapes import MeshSource, ShapeSource
from fullturn.errors import InputError

_ROUNDING_DEG = 1e-6


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
            require_meshes(self, shapes)
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


def require_meshes(protocol: Protocol, shapes: ShapeSource) -> MeshSource:
    """The shapes, which have to be meshes.

    Raises:
        InputError: they are stored samples.
    """
    if not isinstance(shapes, MeshSource):
        raise InputError(
            f"{protocol.name} needs meshes, which a virtual camera can scan; got stored point "
            "samples; pass a mesh pack, a folder of meshes or procedural shapes"
        )
    return shapes


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
