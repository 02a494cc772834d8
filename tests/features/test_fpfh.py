"""FPFH: against Open3D where it is installed, and by its own invariants."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from fullturn.features.fpfh import fpfh
from fullturn.geometry.normals import estimate_normals


def oriented_cloud(n: int = 400) -> tuple[torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(0)
    points = torch.from_numpy(rng.standard_normal((n, 3)))
    points = points / points.norm(dim=-1, keepdim=True) * 0.5
    points[:, 0] *= 1 + points[:, 1]
    # Shaken, so that no two normals are equal: for such a pair the frame would stand on either.
    normals = estimate_normals(points) + 0.02 * torch.from_numpy(rng.standard_normal((n, 3)))
    return points, normals / normals.norm(dim=-1, keepdim=True)


@pytest.mark.parametrize(("radius", "max_neighbors"), [(0.1, 30), (0.25, 100), (0.3, 12)])
def test_agrees_with_open3d(radius: float, max_neighbors: int) -> None:
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    points, normals = oriented_cloud()
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points.numpy()))
    cloud.normals = open3d.utility.Vector3dVector(normals.numpy())
    search = open3d.geometry.KDTreeSearchParamHybrid(radius, max_neighbors)
    expected = open3d.pipelines.registration.compute_fpfh_feature(cloud, search).data.T
    ours = fpfh(points, normals, radius=radius, max_neighbors=max_neighbors)
    np.testing.assert_allclose(ours.numpy(), expected, rtol=0, atol=1e-9)


def test_histogram_sums() -> None:
    points, normals = oriented_cloud()
    points[0] += 10  # alone
    sums = fpfh(points, normals, radius=0.25).view(-1, 3, 11).sum(-1)
    torch.testing.assert_close(sums[1:], torch.full_like(sums[1:], 200.0))
    assert (sums[0] == 0).all()


def test_a_plane_fills_the_middle_bins() -> None:
    points = torch.from_numpy(np.random.default_rng(0).uniform(size=(300, 3)))
    points[:, 2] = 0
    normals = torch.tensor([[0.0, 0, 1]], dtype=torch.float64).expand_as(points)
    histograms = fpfh(points, normals, radius=0.2).view(-1, 3, 11)
    assert (histograms[..., 5] > 199.999).all()


def test_a_batch_equals_the_loop_over_its_items() -> None:
    points, normals = oriented_cloud(120)
    both = fpfh(torch.stack([points, points.flip(0)]), torch.stack([normals, normals.flip(0)]))
    torch.testing.assert_close(both[0], fpfh(points, normals))
    torch.testing.assert_close(both[1].flip(0), both[0])


def test_float32_is_close_to_float64() -> None:
    points, normals = oriented_cloud()
    exact = fpfh(points, normals, radius=0.25, max_neighbors=100)
    single = fpfh(points.float(), normals.float(), radius=0.25, max_neighbors=100)
    assert single.dtype == torch.float32
    # A pair on the border of two bins may change sides.
    assert (single - exact).abs().amax(-1).median() < 1e-2


def test_coincident_points_make_no_pair() -> None:
    points, normals = torch.zeros(5, 3), torch.tensor([[0.0, 0, 1]]).expand(5, 3)
    assert torch.equal(fpfh(points, normals), torch.zeros(5, 33))
