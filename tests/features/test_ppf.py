"""Point pair features: against the plain formula, and where that formula loses its digits."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from fullturn.features.ppf import ppf
from fullturn.geometry.neighbors import knn


def oriented_cloud(*batch: int) -> tuple[torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(0)
    points, normals = torch.from_numpy(rng.standard_normal((2, *batch, 40, 3)))
    return points, normals / normals.norm(dim=-1, keepdim=True)


def test_by_definition() -> None:
    points, normals = oriented_cloud()
    index, distance = knn(points, points, 6)
    features = ppf(points, normals, index)
    d = points[index] - points[:, None]
    unit = (d / d.norm(dim=-1, keepdim=True))[:, 1:]
    n_i, n_j = normals[:, None], normals[index]
    expected = [
        torch.acos((n_i * unit).sum(-1)),
        torch.acos((n_j[:, 1:] * unit).sum(-1)),
        torch.acos((n_i * n_j).sum(-1)[:, 1:]),
        distance[:, 1:],
    ]
    torch.testing.assert_close(features[:, 1:], torch.stack(expected, -1), rtol=0, atol=1e-9)
    torch.testing.assert_close(features[:, 0], torch.zeros(40, 4, dtype=torch.float64))


def test_a_batch_equals_the_loop_over_its_items() -> None:
    points, normals = oriented_cloud(3)
    index, _ = knn(points, points, 6)
    features = ppf(points, normals, index)
    for b in range(3):
        torch.testing.assert_close(features[b], ppf(points[b], normals[b], index[b]))


def test_small_angles_keep_their_digits() -> None:
    angle = 1e-7
    points = torch.tensor([[0.0, 0, 0], [1, 0, 0]])
    normals = torch.tensor([[1.0, 0, 0], [math.cos(angle), math.sin(angle), 0]])
    features = ppf(points, normals, torch.tensor([[1], [0]]))
    assert features.dtype == torch.float32
    assert float(features[0, 0, 2]) == pytest.approx(angle, rel=1e-5)


def test_folding_ignores_the_signs_of_the_normals() -> None:
    points, normals = oriented_cloud()
    index, _ = knn(points, points, 6)
    signs = torch.from_numpy(np.random.default_rng(1).choice([-1.0, 1.0], (40, 1)))
    folded = ppf(points, normals, index, fold=True)
    torch.testing.assert_close(ppf(points, normals * signs, index, fold=True), folded)
    plain = ppf(points, normals, index)
    expected = torch.minimum(plain[..., :3], math.pi - plain[..., :3])
    torch.testing.assert_close(folded[:, 1:, :3], expected[:, 1:])
    assert folded[..., :3].max() <= math.pi / 2


def test_duplicate_and_missing_neighbors_are_finite() -> None:
    points = torch.zeros(4, 3)
    normals = torch.tensor([[0.0, 0, 1]]).expand(4, 3)
    index = torch.tensor([[0, 1, -1]]).expand(4, 3)
    assert torch.equal(ppf(points, normals, index), torch.zeros(4, 3, 4))
