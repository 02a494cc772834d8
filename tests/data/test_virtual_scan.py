from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fullturn.data.motion import move
from fullturn.data.procedural import demo_object
from fullturn.data.scan import scan, scan_overlap, scan_pair
from fullturn.data.solids import box, join, placed, superquadric
from fullturn.data.surface import sample_surface
from fullturn.errors import InputError

CAMERA = np.array([0.0, 0.0, 4.0])


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.parametrize("count", [200, 2048])
def test_a_sphere_shows_exactly_its_near_cap(count: int) -> None:
    points = scan(superquadric((1, 1, 1), sections=200), CAMERA, count=count, rng=rng())
    assert len(points) == count
    # Visible where the tangent plane leaves the camera outside: z > 1/distance.
    assert points[:, 2].min() > 0.25 - 0.08
    assert points[:, 2].min() < 0.4


def test_hidden_surfaces_are_dropped() -> None:
    screen, behind = box((2, 2, 0.1), (0, 0, 1)), box((0.5, 0.5, 0.5))
    points = scan(join([screen, behind]), CAMERA, count=1000, rng=rng())
    assert (points[:, 2] > 0.5).all()


def test_bare_points_and_their_mesh_give_like_scans() -> None:
    mesh = demo_object()
    dense = sample_surface(mesh, 150_000, rng())
    a = scan(mesh, CAMERA, count=1000, rng=rng())
    b = scan(dense, CAMERA, count=1000, rng=rng())
    assert len(b) == 1000
    assert {tuple(p) for p in b} <= {tuple(p) for p in dense}
    assert cKDTree(a).query(b)[0].mean() < 0.05


def test_noise_goes_along_the_line_of_sight() -> None:
    sheet = box((1, 1, 0.01))
    points = scan(sheet, np.array([0, 0, 50.0]), count=2000, rng=rng(), noise_sigma=0.02)
    assert points[:, 2].std() == pytest.approx(0.02, rel=0.1)
    assert np.abs(points[:, :2]).max() < 0.52


def test_grazing_returns_get_lost() -> None:
    ball = superquadric((1, 1, 1), sections=100)
    plain = scan(ball, CAMERA, count=2000, rng=rng())
    lossy = scan(ball, CAMERA, count=2000, rng=rng(), grazing_deg=40.0)
    assert len(lossy) < len(plain)
    # Within 15° of the rim the sine is below 0.26; sin 40° = 0.64 is never lost.
    assert np.mean(lossy[:, 2] < 0.45) < 0.6 * np.mean(plain[:, 2] < 0.45)
    assert np.mean(lossy[:, 2] > 0.9) > np.mean(plain[:, 2] > 0.9)
    with pytest.raises(InputError, match="grazing_deg"):
        scan(sample_surface(ball, 100, rng()), CAMERA, rng=rng(), grazing_deg=10.0)


def test_scans_move_with_surface_and_camera() -> None:
    shift, factor = np.array([1e3, -2e3, 5e2]), 1000.0
    mesh = demo_object()
    far = placed(mesh, translation=shift / factor)
    far.vertices *= factor
    near = scan(mesh, CAMERA, count=500, rng=rng())
    moved = scan(far, CAMERA * factor + shift, count=500, rng=rng())
    assert cKDTree(near * factor + shift).query(moved)[0].max() < 0.15 * factor


def test_a_camera_in_the_mean_is_an_error() -> None:
    points = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    with pytest.raises(InputError, match="away from"):
        scan(points, np.zeros(3), rng=rng())
    with pytest.raises(InputError, match="in front"):
        scan(np.array([[0.0, 0, -1], [0, 0, 1], [0, 0, 3]])[:1] * np.nan, CAMERA, rng=rng())


@pytest.mark.parametrize("seed", range(4))
def test_pairs_overlap_and_agree_under_the_true_pose(seed: int) -> None:
    pair = scan_pair(demo_object(), rng(seed), points=800, min_overlap=0.4)
    moved = move(pair.T_target_source, pair.source)
    assert scan_overlap(moved, pair.target) >= 0.4
    assert len(pair.source) == len(pair.target) == 800
    again = scan_pair(demo_object(), rng(seed), points=800, min_overlap=0.4)
    assert pair.source.tobytes() == again.source.tobytes()


def test_viewpoints_see_their_clouds() -> None:
    pair = scan_pair(superquadric((1, 1, 1)), rng(), points=500)
    for cloud, viewpoint in (
        (pair.source, pair.source_viewpoint),
        (pair.target, pair.target_viewpoint),
    ):
        assert viewpoint is not None
        center = np.linalg.lstsq(
            np.c_[2 * cloud, np.ones(len(cloud))], (cloud**2).sum(axis=1), rcond=None
        )[0][:3]
        assert ((cloud - center) @ (viewpoint - center) > 0).all()


def test_overlap_of_equal_and_distant_clouds() -> None:
    points = sample_surface(demo_object(), 500, rng())
    assert scan_overlap(points, points) == 1.0
    assert scan_overlap(points, points + 10.0) == 0.0
    with pytest.raises(InputError, match="lower min_overlap"):
        scan_pair(box((1, 1, 1)), rng(), points=100, min_overlap=1.1, tries=1)
