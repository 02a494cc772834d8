"""The numbers that the report's viewer draws, small enough to embed in the page."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from fullturn.geometry.motion import move
from fullturn.viz.scene import SPACINGS_TO_FAR, viewing_axes
from fullturn.viz.tables import probability

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from fullturn.result import Registration
    from fullturn.viz.scene import PartnerDistance, Scene

SIDE_BY_SIDE = 1.05  # half the distance between two clouds drawn side by side, in radii


@dataclass(frozen=True, eq=False)
class Frame:
    """Where the viewer has its origin, in the target frame, and its unit of length.

    The aligned pair fills the unit ball, so single precision and 16-bit coordinates are enough
    for clouds of any size anywhere.
    """

    origin: NDArray[np.float64]
    radius: float
    source_center: NDArray[np.float64]  # in the source frame
    target_center: NDArray[np.float64]

    def pose(self, T: NDArray[np.float64]) -> dict[str, Any]:
        """Return the motion of the centered source into the viewer's frame."""
        t = (move(T, self.source_center) - self.origin) / self.radius
        return {"R": T[:3, :3].ravel().tolist(), "t": t.tolist()}


def make_payload(scene: Scene, registration: Registration) -> dict[str, Any]:
    """Return what the viewer needs, as numbers, lists and base64 strings.

    A cloud's points are ``center + unit · step · int16``; the views give the motions of the
    centered source.
    """
    union = np.concatenate([move(registration.T_target_source, scene.source), scene.target])
    origin = middle(union)
    radius = float(np.quantile(np.linalg.norm(union - origin, axis=1), 0.99)) or 1.0
    frame = Frame(origin, radius, middle(scene.source), middle(scene.target))
    drawn_share = min(
        len(scene.source) / scene.source_total, len(scene.target) / scene.target_total
    )
    spacing = scene.far / SPACINGS_TO_FAR / np.sqrt(drawn_share)
    return {
        "unit": radius,
        "dot": float(np.clip(0.8 * spacing / radius, 0.004, 0.03)),
        "camera": viewing_axes(union).ravel().tolist(),
        "center": ((frame.target_center - origin) / radius).tolist(),  # of the target
        "source": encode_points(scene.source, frame.source_center, radius),
        "target": encode_points(scene.target, frame.target_center, radius),
        "views": make_views(scene, registration, frame),
        "matches": {
            "source": encode_points(scene.matches.source, frame.source_center, radius),
            "target": encode_points(scene.matches.target, frame.target_center, radius),
            "weight": encode(scene.matches.weight * 255, "u1"),
        },
    }


def make_views(scene: Scene, registration: Registration, frame: Frame) -> list[dict[str, Any]]:
    """Return what can be looked at: before, after, the matches, then each alternative."""
    near = [encode_distances(distances, scene.far) for distances in scene.distances]
    close = {"gap": 0.0, "extent": 1.1}
    answer = frame.pose(registration.T_target_source)
    shown, total = len(scene.matches.weight), len(registration.matches)
    some = f"{shown:,} of {total:,} matches" if shown < total else f"{total:,} matches"
    views = [
        {
            "name": "Before",
            "caption": "The scans turned as they came, side by side",
            "R": np.eye(3).ravel().tolist(),
            "t": [0.0, 0.0, 0.0],
            "gap": SIDE_BY_SIDE,
            "extent": 1.1,
        },
        {
            "name": "After",
            "caption": "The source moved into the frame of the target",
            "near": near[0],
            **answer,
            **close,
        },
        {
            "name": "Matches",
            "caption": f"{some}, the aligned scans side by side",
            "near": near[0],
            "lines": True,
            **answer,
            "gap": SIDE_BY_SIDE,
            "extent": 1.1,
        },
    ]
    pairs = zip(registration.alternatives, near[1:], strict=False)
    for rank, (other, distances) in enumerate(pairs, start=1):
        views.append(
            {
                "name": f"Alternative {rank}",
                "caption": f"Another pose, probability {probability(other.success_probability)}",
                "near": distances,
                **frame.pose(other.T_target_source),
                **close,
            }
        )
    return views


def middle(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the middle of the bounding box."""
    return (points.min(axis=0) + points.max(axis=0)) / 2


def encode_points(
    points: NDArray[np.float64], center: NDArray[np.float64], radius: float
) -> dict[str, Any]:
    """Store points as 16-bit steps from their center, little-endian, x y z of each in turn."""
    steps = (points - center) / radius
    step = (float(np.abs(steps).max(initial=0.0)) or 1.0) / 32767
    return {"center": center.tolist(), "step": step, "int16": encode(steps / step, "<i2")}


def encode_distances(distances: PartnerDistance, far: float) -> dict[str, str]:
    """Store distances as bytes: 0 at the partner, 255 at `far` or more."""

    def level(values: NDArray[np.float64]) -> str:
        return encode(np.clip(values / far if far > 0 else values, 0.0, 1.0) * 255, "u1")

    return {"source": level(distances.source), "target": level(distances.target)}


def encode(values: NDArray[np.float64], dtype: str) -> str:
    """Round to integers of `dtype` and return their bytes in base64."""
    return base64.b64encode(np.rint(values).astype(dtype).tobytes()).decode("ascii")
