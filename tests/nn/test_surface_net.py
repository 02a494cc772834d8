"""The descriptor network of the default method: what it must not depend on, and its weights."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fullturn.data.shapes import ProceduralShapes
from fullturn.features.surface import distances, shell_counts
from fullturn.geometry import rigid
from fullturn.geometry.normals import estimate_normals
from fullturn.geometry.sampling import local_area, point_spacing
from fullturn.nn import surface
from fullturn.nn.surface import SurfaceNet, load_surface_net


def cloud(count: int = 150) -> tuple[Tensor, Tensor, Tensor]:
    points = torch.from_numpy(
        ProceduralShapes(1, seed=4).points(0, count, np.random.default_rng(0))
    ).float()
    normals = estimate_normals(points, k=12, orientation="centroid")
    return points, normals, local_area(points).float()


def everyone(points: Tensor) -> Tensor:
    return torch.arange(len(points))


@pytest.fixture(scope="module")
def network() -> SurfaceNet:
    torch.manual_seed(0)
    return SurfaceNet().eval()


@torch.no_grad()
def described(
    network: SurfaceNet, points: Tensor, normals: Tensor, area: Tensor, scale: float = 1.0
) -> Tensor:
    found: Tensor = network(points, normals, area, everyone(points), spacing=0.1 * scale)
    return found


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_no_motion_scale_or_order_changes_a_descriptor(network: SurfaceNet, scale: float) -> None:
    points, normals, area = cloud()
    expected = described(network, points, normals, area)
    torch.testing.assert_close(expected.norm(dim=1), torch.ones(len(points)))
    R = rigid.random_rotations_uniform(1, rng=np.random.default_rng(1))[0].float()
    order = torch.randperm(len(points), generator=torch.Generator().manual_seed(1))
    moved = (scale * points @ R.T + scale * torch.tensor([1.0, -2.0, 0.5]))[order]
    found = described(network, moved, (normals @ R.T)[order], area[order], scale)
    torch.testing.assert_close(found, expected[order], atol=5e-3, rtol=0)


def test_signed_counts_agree_with_counting_by_hand() -> None:
    points, normals, area = (part.double() for part in cloud(40))
    radius, shells, bins, power = 0.8, 4, 5, 0.7
    found = shell_counts(
        points, normals, area, distances(points, everyone(points)), everyone(points),
        radius=radius, shells=shells, bins=bins, signed=True, power=power,
    )  # fmt: skip

    def soft(position: float, count: int) -> Tensor:
        place = np.interp(position, np.arange(count), np.arange(count))
        return torch.from_numpy(np.maximum(0.0, 1.0 - np.abs(np.arange(count) - place)))

    expected = torch.zeros(40, shells, 3, bins).double()
    for i in range(40):
        for j in range(40):
            d = points[j] - points[i]
            length = float(d.norm())
            if i == j or length >= radius:
                continue
            in_shell = soft((length / radius) ** power * shells - 0.5, shells)
            cosines = (normals[i] @ d / length, normals[j] @ d / length, normals[i] @ normals[j])
            for number, cosine in enumerate(cosines):
                in_bin = soft((float(cosine) + 1) / 2 * bins - 0.5, bins)
                expected[i, :, number] += area[j] * in_shell[:, None] * in_bin
    torch.testing.assert_close(found, expected.flatten(-2), atol=1e-9, rtol=1e-9)


def test_keypoints_are_told_of_all_points(network: SurfaceNet) -> None:
    points, normals, area = cloud()
    some = torch.arange(0, len(points), 3)
    distance = distances(points, everyone(points)), distances(points, some)
    assert torch.equal(distance[0][some], distance[1])
    told = [
        network.surroundings(points / 0.1, normals, area, of / 0.1, keypoints)
        for of, keypoints in zip(distance, (everyone(points), some), strict=True)
    ]
    torch.testing.assert_close(told[0][some], told[1])


def test_context_are_means_over_shells() -> None:
    points, _, area = (part.double() for part in cloud(30))
    values = torch.randn(30, 2, generator=torch.Generator().manual_seed(0)).double()
    radius, shells = 1.0, 3
    distance = distances(points, everyone(points))
    found = surface._shell_means(values, area, distance, radius=radius, shells=shells)
    for i in range(30):
        distance = (points - points[i]).norm(dim=1)
        for shell in range(shells):
            position = (distance / radius * shells - 0.5).clamp(0, shells - 1)
            weight = (1 - (position - shell).abs()).clamp_min(0) * area * (distance < radius)
            mean = (weight[:, None] * values).sum(0) / weight.sum().clamp_min(1e-3)
            torch.testing.assert_close(found[i, 2 * shell : 2 * shell + 2], mean)


def test_training_reaches_every_weight(network: SurfaceNet) -> None:
    points, normals, area = cloud()
    network.zero_grad()
    network(points, normals, area, everyone(points), spacing=0.1)[:, 0].sum().backward()
    assert all(bool((p.grad != 0).any()) for p in network.parameters() if p.grad is not None)
    assert all(p.grad is not None for p in network.parameters())


def test_the_weights_in_the_package() -> None:
    network = load_surface_net()
    assert network is not None
    assert not network.training
    points, normals, area = cloud(400)
    spacing = point_spacing(points)
    with torch.no_grad():
        found = network(points, normals, area, everyone(points), spacing=spacing)
    # Trained: the descriptors of one cloud tell its points apart.
    alike = found @ found.T
    assert float(alike.median()) < 0.5
