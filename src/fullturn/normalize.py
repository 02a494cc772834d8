"""Common frames and a common length for two clouds, and the way back to the input's units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from fullturn.geometry.cloud import Cloud
from fullturn.geometry.extent import center_and_radius, far_from_the_rest
from fullturn.geometry.motion import skew

_UNLIKE = 10.0
_FARTHEST = 1e6  # lengths: beyond, nothing changes any more but the rounding


@dataclass(frozen=True, eq=False)
class Normalization:
    """x_normalized = (x − center) / length, with one length for both clouds."""

    source_center: np.ndarray  # (3,) mean, in the input's unit
    target_center: np.ndarray  # (3,)
    length: float  # in the input's unit
    notes: tuple[str, ...] = ()

    def denormalize(self, T_target_source_normalized: np.ndarray) -> np.ndarray:
        """The pose (4, 4) in the input's frames: R stays, t = length tₙ + c_t − R c_s."""
        T_target_source = np.array(T_target_source_normalized, dtype=np.float64)
        R = T_target_source[:3, :3]
        T_target_source[:3, 3] *= self.length
        T_target_source[:3, 3] += self.target_center - R @ self.source_center
        return T_target_source

    def normalize(self, T_target_source: np.ndarray) -> np.ndarray:
        """The pose (4, 4) between the normalized clouds: the inverse of `denormalize`."""
        T_normalized = np.array(T_target_source, dtype=np.float64)
        R = T_normalized[:3, :3]
        T_normalized[:3, 3] += R @ self.source_center - self.target_center
        T_normalized[:3, 3] /= self.length
        return T_normalized

    def denormalize_covariance(self, covariance_normalized: np.ndarray) -> np.ndarray:
        """The covariance (6, 6) of a right perturbation, in the input's frames.

        The perturbation ω × xₙ + vₙ of a normalized source point is ω × x + v in the input's
        source frame, with v = length vₙ + c_s × ω, so C = A Cₙ Aᵀ with A = [I 0; [c_s]× length I].
        """
        adjoint = np.eye(6)
        adjoint[3:, :3] = skew(self.source_center)
        adjoint[3:, 3:] *= self.length
        covariance = adjoint @ covariance_normalized @ adjoint.T
        return (covariance + covariance.T) / 2.0


def normalized_clouds(
    source: np.ndarray,
    target: np.ndarray,
    source_viewpoint: np.ndarray | None = None,
    target_viewpoint: np.ndarray | None = None,
) -> tuple[Cloud, Cloud, Normalization]:
    """Both clouds as a method sees them, and the way back to the input's frames.

    Points are float64 (N, 3); a viewpoint (3,) is in the frame and unit of its cloud.
    """
    frame = normalization_of(source, target)
    return (
        _cloud(source, source_viewpoint, frame.source_center, frame.length),
        _cloud(target, target_viewpoint, frame.target_center, frame.length),
        frame,
    )


def normalization_of(source: np.ndarray, target: np.ndarray) -> Normalization:
    """Centers are the means; the length is the larger of the two clouds' radii."""
    source_center, source_radius = center_and_radius(source)
    target_center, target_radius = center_and_radius(target)
    ratio = source_radius / target_radius
    notes = (
        *stray_notes("source", source, source_center, source_radius),
        *stray_notes("target", target, target_center, target_radius),
    )
    if not 1.0 / _UNLIKE < ratio < _UNLIKE:
        notes += (f"the source is {ratio:.3g} times as large as the target: is the unit the same?",)
    return Normalization(source_center, target_center, max(source_radius, target_radius), notes)


def _cloud(
    points: np.ndarray, viewpoint: np.ndarray | None, center: np.ndarray, length: float
) -> Cloud:
    def seen(values: np.ndarray) -> torch.Tensor:
        normalized = (values - center) / length
        away = np.abs(normalized).max(axis=-1, keepdims=True)
        return torch.from_numpy(normalized * np.minimum(1.0, _FARTHEST / np.maximum(away, 1.0)))

    return Cloud(seen(points), None if viewpoint is None else seen(viewpoint))


def stray_notes(
    name: str, points: np.ndarray, center: np.ndarray, radius: float
) -> tuple[str, ...]:
    """What a user should know of points (n, 3) that lie far from the rest of their cloud."""
    far = points[far_from_the_rest(points, center, radius)]
    if not len(far):
        return ()
    what = "1 point lies" if len(far) == 1 else f"{len(far)} points lie"
    away = np.linalg.norm(far - center, axis=1).max() / radius
    return (f"{name}: {what} far from the rest, up to {away:.3g} radii: a stray return?",)
