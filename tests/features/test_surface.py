"""The surface histogram agrees with counting by hand and does not change with the frame."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from fullturn.features.surface import surface_histogram
from fullturn.geometry.sampling import local_area

RADIUS = 0.9


def bent_sheet(count: int, *, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Points of z = 0.3 x² − 0.2 y² + 0.1 xy over a square, and their unit normals."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-1, 1, (2, count))
    points = np.stack([x, y, 0.3 * x**2 - 0.2 * y**2 + 0.1 * x * y], 1)
    normals = np.stack([-0.6 * x - 0.1 * y, 0.4 * y - 0.1 * x, np.ones(count)], 1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return torch.from_numpy(points), torch.from_numpy(normals)


def described(points: Tensor, normals: Tensor, *, radius: float, shells: int = 5) -> Tensor:
    """The histograms with the area that the cloud itself gives."""
    return surface_histogram(points, normals, local_area(points), radius=radius, shells=shells)


def counted(
    points: np.ndarray,
    normals: np.ndarray,
    area: np.ndarray,
    *,
    radius: float,
    shells: int = 5,
    bins: int = 5,
) -> np.ndarray:
    """The definition, pair by pair, with np.interp as the linear membership."""
    rows = []
    for i, (p, n) in enumerate(zip(points, normals, strict=True)):
        table = np.zeros((shells, 3, bins))
        for j, (q, m) in enumerate(zip(points, normals, strict=True)):
            d = q - p
            length = np.linalg.norm(d)
            if i == j or length >= radius:
                continue
            u = d / length
            shell = area[j] * soft(length / radius, shells)
            for k, cosine in enumerate((abs(n @ u), abs(m @ u), abs(n @ m))):
                table[:, k] += np.outer(shell, soft(cosine, bins))
        rows.append(np.sqrt(table.ravel() / max(table.sum(), 1e-12)))
    return np.array(rows)


def soft(value: np.floating | float, bins: int) -> np.ndarray:
    centers = (np.arange(bins) + 0.5) / bins
    return np.array([np.interp(value, centers, np.eye(bins)[b]) for b in range(bins)])


@pytest.mark.parametrize(("shells", "bins"), [(5, 5), (3, 4), (1, 2)])
def test_agrees_with_counting_by_hand(shells: int, bins: int) -> None:
    points, normals = bent_sheet(70)
    area = torch.from_numpy(np.random.default_rng(5).uniform(0.1, 10, 70))
    found = surface_histogram(points, normals, area, radius=RADIUS, shells=shells, bins=bins)
    expected = counted(
        points.numpy(), normals.numpy(), area.numpy(), radius=RADIUS, shells=shells, bins=bins
    )
    # Counts are differences of sums, and square roots make small numbers large.
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-6)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("offset", [0.0, 1e6])
@pytest.mark.parametrize("angle_deg", [0.0, 1e-4, 73.0, 180.0])
def test_no_motion_scale_or_sign_changes_it(scale: float, offset: float, angle_deg: float) -> None:
    points, normals = bent_sheet(90)
    expected = described(points, normals, radius=RADIUS)
    rng = np.random.default_rng(1)
    axis = rng.normal(size=3)
    R = Rotation.from_rotvec(np.radians(angle_deg) * axis / np.linalg.norm(axis)).as_matrix()
    signs = torch.from_numpy(rng.choice([-1.0, 1.0], (90, 1)))
    turn = torch.from_numpy(R)
    moved = (points @ turn.T) * scale + offset * scale
    found = described(moved, normals @ turn.T * signs, radius=RADIUS * scale)
    torch.testing.assert_close(found, expected, atol=1e-5 if offset else 1e-7, rtol=0)


def test_rows_have_unit_length_and_follow_the_points() -> None:
    points, normals = bent_sheet(90)
    rows = described(points, normals, radius=RADIUS)
    torch.testing.assert_close(rows.norm(dim=1), torch.ones(90).double())
    order = torch.from_numpy(np.random.default_rng(2).permutation(90))
    torch.testing.assert_close(described(points[order], normals[order], radius=RADIUS), rows[order])


def test_density_matters_little() -> None:
    points, normals = bent_sheet(900)
    rows = described(points, normals, radius=RADIUS)
    rng = np.random.default_rng(6)
    kept = torch.from_numpy((points[:, 0].numpy() < 0) | (rng.random(900) < 0.2))
    thinned = described(points[kept], normals[kept], radius=RADIUS)
    similarity = (rows[kept] * thinned).sum(1)
    assert float(similarity.min()) > 0.95
    assert float(similarity.median()) > 0.985
    even = torch.ones(900).double()
    unweighted = surface_histogram(points, normals, even, radius=RADIUS)[kept]
    unweighted_thinned = surface_histogram(points[kept], normals[kept], even[kept], radius=RADIUS)
    assert float(similarity.mean()) > float((unweighted * unweighted_thinned).sum(1).mean())


def test_single_precision_agrees_with_double() -> None:
    points, normals = bent_sheet(200)
    found = described(points.float(), normals.float(), radius=RADIUS)
    assert found.dtype == torch.float32
    expected = described(points, normals, radius=RADIUS)
    assert float((found.double() - expected).norm(dim=1).max()) < 2e-3


def test_small_noise_moves_it_little_and_another_surface_far() -> None:
    points, normals = bent_sheet(300)
    rows = described(points, normals, radius=RADIUS)
    noise = torch.from_numpy(np.random.default_rng(3).normal(0, 1e-3, (300, 3)))
    shaken = described(points + noise, normals, radius=RADIUS)
    own = (rows * shaken).sum(1)
    assert float(own.min()) > 0.995
    flat = points * torch.tensor([1.0, 1.0, 0.0])
    up = torch.tensor([0.0, 0.0, 1.0]).double().expand(300, 3)
    assert float((rows * described(flat, up, radius=RADIUS)).sum(1).median()) < 0.98
    assert float(own.median()) > 0.999


def test_duplicates_and_lonely_points_give_finite_rows() -> None:
    points, normals = bent_sheet(200)
    lonely = torch.tensor([[50.0, 0, 0], [0, 50.0, 0]]).double()
    twice = torch.cat([points, points, lonely])
    rows = described(twice, torch.cat([normals, normals, normals[:2]]), radius=RADIUS)
    assert bool(torch.isfinite(rows).all())
    assert float(rows[-2:].norm()) == 0.0
    # Copies double every count but that of the point itself.
    expected = described(points, normals, radius=RADIUS)
    assert float((rows[:200] * expected).sum(1).min()) > 0.98
    many = points[:10].repeat(40, 1)
    found = described(many, normals[:10].repeat(40, 1), radius=RADIUS)
    assert bool(torch.isfinite(found).all())


def test_a_plane_fills_the_bins_of_right_angles() -> None:
    rng = np.random.default_rng(4)
    flat = torch.from_numpy(rng.uniform(-1, 1, (200, 3))) * torch.tensor([1.0, 1.0, 0.0])
    up = torch.tensor([0.0, 0.0, 1.0]).double().expand(200, 3)
    share = described(flat, up, radius=0.5).square().view(200, 5, 3, 5).sum(1)
    expected = torch.zeros(3, 5).double()
    expected[0, 0] = expected[1, 0] = expected[2, 4] = 1 / 3
    torch.testing.assert_close(share, expected.expand(200, 3, 5), atol=1e-9, rtol=0)
    # Of uniform points within r, the share closer than x is (x/r)².
    near = described(flat, up, radius=0.5, shells=2).square()
    assert math.isclose(float(near.view(200, 2, 15)[:, 0].sum(1).mean()), 1 / 3, abs_tol=0.05)
