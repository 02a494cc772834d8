"""Normals: the closed-form eigensolver against LAPACK, equivariance, orientation rules."""

from __future__ import annotations

import numpy as np
import pytest
import small_gicp
import torch

from fullturn.errors import InputError
from fullturn.geometry import normals as normals_module
from fullturn.geometry.neighbors import knn, radius_neighbors
from fullturn.geometry.normals import eigen_symmetric_3x3, estimate_normals
from fullturn.geometry.rigid import random_rotations_uniform


def ellipsoid(n: int = 400, *, seed: int = 0) -> torch.Tensor:
    points = torch.from_numpy(np.random.default_rng(seed).standard_normal((n, 3)))
    scale = torch.tensor([1.0, 0.7, 0.5], dtype=torch.float64)
    return points / points.norm(dim=-1, keepdim=True) * scale


def with_spectrum(*spectrum: float) -> torch.Tensor:
    Q = random_rotations_uniform(300, rng=np.random.default_rng(1))
    A = Q @ torch.diag(torch.tensor(spectrum, dtype=torch.float64)) @ Q.mT
    return (A + A.mT) / 2


def random_symmetric() -> torch.Tensor:
    A = torch.from_numpy(np.random.default_rng(2).standard_normal((2000, 3, 3)))
    return A + A.mT


MATRICES = {
    "random": random_symmetric(),
    "huge": random_symmetric() * 1e15,
    "tiny": random_symmetric() * 1e-15,
    "covariance": with_spectrum(1e-9, 1e-4, 1.0),
    "planar": with_spectrum(0.0, 1.0, 2.0),
    "linear": with_spectrum(0.0, 0.0, 1.0),
    "double low": with_spectrum(1.0, 1.0, 2.0),
    "double high": with_spectrum(1.0, 2.0, 2.0),
    "nearly double low": with_spectrum(1.0, 1.0 + 1e-8, 2.0),
    "nearly double high": with_spectrum(1.0, 2.0, 2.0 + 1e-8),
    "nearly isotropic": with_spectrum(1.0, 1.0 + 1e-8, 1.0 + 3e-8),
    "isotropic": with_spectrum(1.0, 1.0, 1.0),
    "identity": torch.eye(3, dtype=torch.float64)[None],
    "diagonal": torch.diag(torch.tensor([3.0, 1.0, 2.0], dtype=torch.float64))[None],
    "zero": torch.zeros(1, 3, 3, dtype=torch.float64),
}


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("A", MATRICES.values(), ids=MATRICES)
def test_eigenvalues_and_vectors(A: torch.Tensor, dtype: torch.dtype) -> None:
    A = A.to(dtype)
    eps = 50 * torch.finfo(dtype).eps
    size = A.abs().amax()
    values, vectors = eigen_symmetric_3x3(A)
    assert values.dtype == vectors.dtype == dtype
    assert (values.diff(dim=-1) >= 0).all()
    reference = torch.linalg.eigvalsh(A.double())
    assert (values - reference).abs().max() <= eps * size
    assert (A @ vectors - vectors * values[..., None, :]).abs().max() <= eps * size
    identity = torch.eye(3, dtype=dtype)
    assert (vectors.mT @ vectors - identity).abs().max() <= eps
    assert (torch.linalg.det(vectors) - 1).abs().max() <= eps


def test_separated_eigenvectors_agree_with_lapack() -> None:
    A = random_symmetric()
    reference_values, reference = torch.linalg.eigh(A)
    clear = reference_values.diff(dim=-1).amin(-1) > 0.1
    _, vectors = eigen_symmetric_3x3(A)
    cosines = (vectors * reference).sum(-2).abs()
    assert (cosines[clear] - 1).abs().max() < 1e-12


def test_any_batch_shape() -> None:
    A = random_symmetric()[:6]
    values, vectors = eigen_symmetric_3x3(A.view(2, 3, 3, 3))
    one_values, one_vectors = eigen_symmetric_3x3(A[4])
    torch.testing.assert_close(values[1, 1], one_values)
    torch.testing.assert_close(vectors[1, 1], one_vectors)


def test_eigen_gradients_where_the_eigenvalues_differ() -> None:
    A = torch.tensor([[2.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 0.2]], dtype=torch.float64)

    def symmetric(M: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return eigen_symmetric_3x3((M + M.mT) / 2)

    assert torch.autograd.gradcheck(symmetric, (A.requires_grad_(),))


def test_normals_agree_with_small_gicp() -> None:
    points = ellipsoid()
    preprocessed = small_gicp.PointCloud(points.numpy())
    small_gicp.estimate_normals(preprocessed, num_neighbors=20)
    reference = torch.from_numpy(np.asarray(preprocessed.normals())[:, :3].copy())
    normals = estimate_normals(points, k=20)
    assert ((normals * reference).sum(-1).abs() - 1).abs().max() < 1e-9


def test_hybrid_normals_agree_with_open3d() -> None:
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    points = ellipsoid(2000)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points.numpy()))
    cloud.estimate_normals(open3d.geometry.KDTreeSearchParamHybrid(radius=0.1, max_nn=30))
    cloud.orient_normals_towards_camera_location(np.zeros(3))
    reference = torch.from_numpy(np.asarray(cloud.normals).copy())
    normals = estimate_normals(
        points,
        neighbor_index=radius_neighbors(points, points, 0.1, max_neighbors=30)[0],
        orientation="origin",
    )
    enough = (knn(points, points, 4)[1][:, 3] < 0.1).nonzero()[:, 0]
    assert len(enough) > 1500
    assert ((normals * reference).sum(-1)[enough] - 1).abs().max() < 1e-6


def test_a_sphere_has_radial_normals() -> None:
    points = ellipsoid(3000) / torch.tensor([1.0, 0.7, 0.5], dtype=torch.float64)
    result = estimate_normals(points)
    assert (result * points).sum(-1).min() > 0.99


@pytest.mark.parametrize("offset", [0.0, 1e6])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_normals_turn_with_the_cloud(scale: float, offset: float) -> None:
    points = ellipsoid()
    R = random_rotations_uniform(1, rng=np.random.default_rng(4))[0]
    # One rule moves with every rigid motion, one if its viewpoint does, one with rotations.
    viewpoint = torch.tensor([3.0, 0.0, 1.0], dtype=torch.float64)
    tolerance = 1e-9 if offset == 0 else 1e-5 / scale
    for orientation in ("centroid", "viewpoint", "origin"):
        shift = 0.0 if orientation == "origin" else offset
        before = estimate_normals(points, orientation=orientation, viewpoint=viewpoint)
        after = estimate_normals(
            points @ R.mT * scale + shift,
            orientation=orientation,
            viewpoint=viewpoint @ R.mT * scale + shift,
        )
        assert (after - before @ R.mT).abs().amax(-1).median() < tolerance
        if offset == 0:
            assert (after - before @ R.mT).abs().max() < tolerance


def test_orientation_rules() -> None:
    points = ellipsoid() + 0.1
    viewpoint = torch.tensor([0.0, 0.0, 5.0], dtype=torch.float64)
    towards = {
        "origin": -points,
        "viewpoint": viewpoint - points,
        "centroid": points - points.mean(0),
    }
    for orientation, direction in towards.items():
        normals = estimate_normals(points, orientation=orientation, viewpoint=viewpoint)
        assert ((normals * direction).sum(-1) >= -1e-12).all()
    unsigned = estimate_normals(points, orientation="none")
    largest = unsigned.gather(-1, unsigned.abs().argmax(-1, keepdim=True))
    assert (largest > 0).all()


def test_a_flat_cloud_has_one_side() -> None:
    points = ellipsoid()
    points[:, 2] = 0
    R = random_rotations_uniform(1, rng=np.random.default_rng(7))[0]
    result = estimate_normals(points @ R.mT)
    assert (result @ result[0] > 0.999999).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    "points",
    [
        torch.tensor([[0.0, 0, 0], [1, 1, 1], [2, 2, 2], [3, 3, 3]]),
        torch.zeros(5, 3),
        torch.tensor([[1.0, 2, 3]]),
        torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    ],
    ids=["collinear", "coincident", "single", "four"],
)
def test_degenerate_clouds_get_unit_normals(points: torch.Tensor, dtype: torch.dtype) -> None:
    points = points.to(dtype)
    result = estimate_normals(points, k=3)
    assert (result.norm(dim=-1) - 1).abs().max() < 1e-5
    if len(points) == 4 and points[3, 0] == 3:
        assert (result @ points[1]).abs().max() < 1e-5


def test_missing_neighbors_are_left_out() -> None:
    points = ellipsoid()
    index, _ = knn(points, points, 12)
    padded = torch.cat([index, torch.full_like(index, -1)], dim=-1)
    expected = estimate_normals(points, neighbor_index=index)
    result = estimate_normals(points, neighbor_index=padded)
    torch.testing.assert_close(result, expected)


def test_queries_get_the_normals_of_the_full_cloud() -> None:
    points = ellipsoid()
    everywhere = estimate_normals(points, k=15)
    some = estimate_normals(points, k=15, queries=points[10:20])
    torch.testing.assert_close(some, everywhere[10:20])


def test_parts_do_not_change_the_result(monkeypatch: pytest.MonkeyPatch) -> None:
    points = ellipsoid()
    whole = estimate_normals(points)
    monkeypatch.setattr(normals_module, "_NEIGHBORS_AT_ONCE", 1000)
    parts = estimate_normals(points)
    torch.testing.assert_close(parts, whole, rtol=0, atol=1e-12)


@pytest.mark.usefixtures("unchecked")
def test_bad_arguments_are_named() -> None:
    points = ellipsoid(20)
    with pytest.raises(InputError, match="must be one of origin, viewpoint, centroid, none"):
        estimate_normals(points, orientation="up")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="needs the sensor position"):
        estimate_normals(points, orientation="viewpoint")
    with pytest.raises(InputError, match="one row per query, 5, got 20"):
        estimate_normals(points, neighbor_index=knn(points, points, 3)[0], queries=points[:5])
