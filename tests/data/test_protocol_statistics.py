"""The pairs have the overlaps and angles that were measured on the published protocols."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from fullturn.data.draw import ProtocolPairs
from fullturn.data.protocols import PROTOCOLS, Protocol
from fullturn.data.shapes import ProceduralShapes
from fullturn.data.stored import StoredPoints
from fullturn.geometry.motion import move

COUNT = 300


@pytest.fixture(scope="module")
def shapes() -> StoredPoints:
    """60 generated objects, sampled once."""
    objects = ProceduralShapes(60, seed=11)
    rng = np.random.default_rng(0)
    points = np.stack([objects.points(i, 2048, rng) for i in range(60)])
    return StoredPoints(points, [objects.name(i) for i in range(60)], ["generated"] * 60)


def measure(protocol: Protocol, shapes: StoredPoints) -> tuple[np.ndarray, np.ndarray]:
    """Per pair: the share of points with an exact partner, and the relative angle (deg)."""
    overlap, angle_deg = [], []
    for pair in ProtocolPairs(protocol, shapes, count=COUNT):
        nearest = cKDTree(pair.target).query(move(pair.T_target_source, pair.source))[0]
        overlap.append(np.mean(nearest < 1e-9))
        angle_deg.append(np.degrees(Rotation.from_matrix(pair.T_target_source[:3, :3]).magnitude()))
    return np.array(overlap), np.array(angle_deg)


def close(values: np.ndarray, expected: float, *, rounding: float) -> bool:
    """Whether the mean is as expected, within three standard errors and the rounding of it."""
    return bool(abs(values.mean() - expected) < 3 * values.std() / np.sqrt(len(values)) + rounding)


@pytest.mark.parametrize(("limit_deg", "expected"), [(180, 0.82), (45, 0.945)])
def test_same_sample_overlap_and_angle(
    shapes: StoredPoints, limit_deg: int, expected: float
) -> None:
    overlap, angle_deg = measure(PROTOCOLS[f"modelnet40/clean/{limit_deg}"], shapes)
    assert close(overlap, expected, rounding=0.005)
    # Both keep 768 of the same 1,024.
    assert overlap.min() >= 512 / 768
    assert close(angle_deg, limit_deg / 2, rounding=0.0)
    # The more the two are turned against each other, the less they share.
    assert np.corrcoef(overlap, angle_deg)[0, 1] < -0.5


@pytest.mark.parametrize(
    ("name", "expected", "least"), [("rpmnet/45", 0.705, 0.4 / 0.7), ("predator/45", 0.5, 0.0)]
)
def test_overlap_of_two_plane_cuts(
    shapes: StoredPoints, name: str, expected: float, least: float
) -> None:
    # All points that a plane leaves, not 717 of them: what is shared can be counted then.
    protocol = PROTOCOLS[name]
    kept = int(protocol.kept_share * protocol.sample_points)
    whole = dataclasses.replace(protocol, noise_sigma=0.0, cloud_points=kept)
    overlap, angle_deg = measure(whole, shapes)
    assert close(overlap, expected, rounding=0.005)
    assert overlap.min() >= least - 2 / kept
    # Rx·Ry·Rz of three angles from 0° to 45°: a mean of 44.7°.
    assert close(angle_deg, 44.7, rounding=0.05)
