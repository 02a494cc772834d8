"""RRI: against the definition with its k × k table of angles, and in degenerate places."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from fullturn.errors import InputError
from fullturn.features.rri import rri
from fullturn.geometry.neighbors import knn
from fullturn.geometry.rigid import random_rotations_uniform


def by_definition(points: np.ndarray, index: np.ndarray) -> np.ndarray:
    points = points - points.mean(0)
    result = np.zeros((*index.shape, 4))
    for i, p in enumerate(points):
        axis = p / np.linalg.norm(p)
        tangents = [points[j] - (points[j] @ axis) * axis for j in index[i]]
        for a, j in enumerate(index[i]):
            q = points[j]
            cosine = p @ q / np.linalg.norm(p) / np.linalg.norm(q)
            result[i, a, :3] = [
                np.linalg.norm(p),
                np.linalg.norm(q),
                math.acos(np.clip(cosine, -1, 1)),
            ]
            if j == i:
                continue
            turns = [
                math.atan2(axis @ np.cross(tangents[a], other), tangents[a] @ other) % (2 * math.pi)
                for other, b in zip(tangents, index[i], strict=True)
                if b not in (i, j)
            ]
            result[i, a, 3] = min(turns, default=0.0)
    return result


@pytest.mark.parametrize("k", [2, 3, 12])
def test_by_definition(k: int) -> None:
    points = torch.from_numpy(np.random.default_rng(0).standard_normal((60, 3)))
    index, _ = knn(points, points, k)
    expected = by_definition(points.numpy(), index.numpy())
    np.testing.assert_allclose(rri(points, index).numpy(), expected, rtol=0, atol=1e-7)


def test_without_the_point_itself() -> None:
    points = torch.from_numpy(np.random.default_rng(0).standard_normal((60, 3)))
    index = knn(points, points, 9)[0]
    without = rri(points, index[:, 1:])
    torch.testing.assert_close(without, rri(points, index)[:, 1:])
    # The gaps between neighbors add up to one full turn.
    torch.testing.assert_close(
        without[..., 3].sum(-1), torch.full((60,), 2 * math.pi, dtype=torch.float64)
    )


def test_a_batch_equals_the_loop_over_its_items() -> None:
    points = torch.from_numpy(np.random.default_rng(0).standard_normal((2, 3, 30, 3)))
    index, _ = knn(points, points, 5)
    center = torch.from_numpy(np.random.default_rng(1).standard_normal((2, 3, 3)))
    features = rri(points, index, center=center)
    for b in np.ndindex(2, 3):
        torch.testing.assert_close(features[b], rri(points[b], index[b], center=center[b]))


def test_the_handedness_is_about_the_outward_axis() -> None:
    # Seen from outside (from +z), b follows a counterclockwise by 90°.
    points = torch.tensor([[0.0, 0, 1], [1, 0, 1], [0, 1, 1]])
    index = torch.tensor([[1, 2]]).expand(3, 2)
    phi = rri(points, index, center=torch.zeros(3))[0, :, 3]
    torch.testing.assert_close(phi, torch.tensor([math.pi / 2, 3 * math.pi / 2]))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    "points",
    [
        torch.zeros(4, 3),
        torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]),
        torch.tensor([[-1.0, 0, 0], [0, 0, 0], [1, 0, 0]]),
        torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    ],
    ids=["coincident", "collinear", "a point at the center", "four"],
)
def test_degenerate_clouds_are_finite(points: torch.Tensor, dtype: torch.dtype) -> None:
    points = points.to(dtype)
    index, _ = knn(points, points, 3)
    for neighbor_index in (index, index.roll(1, dims=-1), torch.where(index == 1, -1, index)):
        features = rri(points, neighbor_index)
        assert torch.isfinite(features).all()
        assert (features >= 0).all()
        assert (features[..., 3] < 2 * math.pi).all()
    if len(points) == 4 and points[3, 0] == 3:
        # Everything lies straight above or below everything else.
        assert (rri(points, index)[..., 3] == 0).all()


def test_one_neighbor_is_an_error() -> None:
    with pytest.raises(InputError, match="needs at least 2 per point, got 1"):
        rri(torch.zeros(4, 3), torch.zeros(4, 1, dtype=torch.int64))


def test_neighbors_in_a_row_share_their_gap_in_every_pose() -> None:
    # From the first point, the next two lie in one direction; the fourth is a quarter turn on.
    cloud = torch.tensor([[1.0, 0, 0], [1, 0.1, 0], [1, 0.2, 0], [1, 0, 0.3]], dtype=torch.float64)
    index = torch.arange(4).expand(4, 4)
    rng = np.random.default_rng(0)
    quarter = math.pi / 2
    for R in random_rotations_uniform(20, rng=rng).double():
        phi = rri(cloud @ R.mT, index, center=torch.zeros(3, dtype=torch.float64))[0, :, 3]
        expected = torch.tensor([0.0, quarter, quarter, 3 * quarter], dtype=torch.float64)
        torch.testing.assert_close(phi, expected, atol=1e-9, rtol=0)
    # Where all lie in one direction there is no other one.
    phi = rri(cloud[:3], index[:3, :3], center=torch.zeros(3, dtype=torch.float64))[0, :, 3]
    torch.testing.assert_close(phi, torch.zeros(3, dtype=torch.float64))
