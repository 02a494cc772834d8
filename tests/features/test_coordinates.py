"""Coordinates of neighbors, by definition."""

from __future__ import annotations

import numpy as np
import torch

from fullturn.features.coordinates import delta_xyz, xyz
from fullturn.geometry.neighbors import knn


def test_by_definition_in_a_batch() -> None:
    points = torch.from_numpy(np.random.default_rng(0).standard_normal((2, 30, 3)))
    index, distance = knn(points, points, 5)
    neighbors, offsets = xyz(points, index), delta_xyz(points, index)
    for b in range(2):
        assert torch.equal(neighbors[b], points[b][index[b]])
        assert torch.equal(offsets[b], points[b][index[b]] - points[b][:, None])
    torch.testing.assert_close(offsets.norm(dim=-1), distance)
    assert (offsets[..., 0, :] == 0).all()


def test_a_missing_neighbor_is_the_point_itself() -> None:
    points = torch.tensor([[1.0, 2, 3], [4, 5, 6]])
    index = torch.tensor([[1, -1], [-1, 0]])
    assert torch.equal(xyz(points, index), points[torch.tensor([[1, 0], [1, 0]])])
    assert (delta_xyz(points, index)[[0, 1], [1, 0]] == 0).all()
