"""What a virtual scanner sees, and pairs of its views."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from fullturn.data.camera import Camera, look_at
from fullturn.data.overlap import scan_overlap
from fullturn.data.pair import Pair
from fullturn.data.procedural import demo_object
from fullturn.data.raycast import mesh_ball
from fullturn.data.scan import scan_pair
from fullturn.data.scanner import Scanner, spread
from fullturn.data.sensor import Sensor
from fullturn.data.solids import box, join, placed, superquadric
from fullturn.data.surface import sample_surface
from fullturn.errors import InputError
from fullturn.geometry.motion import move

BALL = superquadric((1, 1, 1), sections=100)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def camera(distance: float = 4.0, *, pixels: int = 32, fov_deg: float = 30.0) -> Camera:
    eye = np.array([0.0, 0.0, distance])
    return look_at(eye, np.zeros(3), fov_deg=fov_deg, width=pixels, height=pixels)


@pytest.mark.parametrize("wanted", [5, 200, 2048, 9000])
def test_a_look_has_as_many_returns_as_wanted_and_not_many_more(wanted: int) -> None:
    seen = Scanner(BALL).look(camera(), wanted=wanted, enough=wanted, rng=rng())
    assert seen is not None
    # 32 × 32 pixels give 750; a tenth more a side is asked for than it takes.
    assert wanted <= len(seen.points) <= max(1.35 * wanted, 800)
    assert seen.camera.width == seen.camera.height
    assert seen.camera.focal / seen.camera.width == pytest.approx(camera().focal / 32)
    # Visible where the tangent plane leaves the camera outside: z > 1/distance.
    assert 0.25 - 0.02 < seen.points[:, 2].min() < 0.45
    np.testing.assert_allclose(np.linalg.norm(seen.points, axis=1), 1.0, atol=2e-3)


def test_returns_come_in_random_order() -> None:
    seen = Scanner(BALL).look(camera(), wanted=500, enough=500, rng=rng())
    assert seen is not None
    rows = np.abs(np.corrcoef(np.arange(len(seen.points)), seen.points.T))[0, 1:]
    assert rows.max() < 0.15


@pytest.mark.parametrize("backend", ["auto", "python"])
def test_hidden_surfaces_are_not_seen(backend: str) -> None:
    room = join([box((2, 2, 0.1), (0, 0, 1)), box((0.5, 0.5, 0.5))])
    seen = Scanner(room, backend=backend).look(camera(), wanted=1000, enough=1000, rng=rng())  # type: ignore[arg-type]
    assert seen is not None
    assert (seen.points[:, 2] > 0.5).all()


def test_a_camera_inside_sees_the_walls_around_it() -> None:
    seen = Scanner(BALL).look(camera(0.3, fov_deg=60.0), wanted=600, enough=600, rng=rng())
    assert seen is not None
    np.testing.assert_allclose(np.linalg.norm(seen.points, axis=1), 1.0, atol=2e-3)
    assert (seen.points[:, 2] < 0.0).all()


def test_nothing_is_seen_of_what_is_elsewhere() -> None:
    scanner = Scanner(placed(BALL, translation=np.array([50.0, 0, 0])))
    assert scanner.look(camera(), wanted=10, enough=1, rng=rng()) is None
    # A sensor that loses all returns, too.
    scanner = Scanner(BALL, sensor=Sensor(quantize=1000.0))
    assert scanner.look(camera(), wanted=10, enough=1, rng=rng()) is None


def test_a_thin_thing_is_seen_by_what_it_has() -> None:
    scanner = Scanner(box((2, 0.06, 0.06)))
    seen = scanner.look(camera(pixels=64), wanted=100_000, enough=100, rng=rng())
    assert seen is not None
    assert 100 <= len(seen.points) < 100_000
    assert seen.camera.width == 640
    assert scanner.look(camera(pixels=64), wanted=100_000, enough=100_000, rng=rng()) is None


def test_noise_goes_along_the_camera_and_grows_with_its_radius() -> None:
    sheet = box((1, 1, 0.01))
    sensor = Sensor(noise=0.02 / 50.0**2)
    far = camera(50.0, fov_deg=1.6)
    for radius in (1.0, 3.0):
        seen = Scanner(sheet, sensor=sensor, radius=radius).look(
            far, wanted=2000, enough=2000, rng=rng()
        )
        assert seen is not None
        assert seen.points[:, 2].std() == pytest.approx(0.02 / radius, rel=0.1)
        assert np.abs(seen.points[:, :2]).max() < 0.52


def test_lost_returns_are_made_up_for_by_more_pixels() -> None:
    plain, lossy = (
        Scanner(BALL, sensor=sensor).look(camera(), wanted=2000, enough=2000, rng=rng())
        for sensor in (Sensor(), Sensor(grazing_deg=40.0))
    )
    assert plain is not None
    assert lossy is not None
    assert lossy.camera.width > plain.camera.width
    # Within 15° of the rim the sine is below 0.26; sin 40° = 0.64 is never lost.
    assert np.mean(lossy.points[:, 2] < 0.45) < 0.6 * np.mean(plain.points[:, 2] < 0.45)


def test_spread_points_are_farther_apart_than_random_ones() -> None:
    points = sample_surface(demo_object(), 1000, rng())
    chosen = spread(points, 300)
    assert len(np.unique(chosen, axis=0)) == 300
    gaps = [cKDTree(some).query(some, k=2)[0][:, 1].min() for some in (chosen, points[:300])]
    assert gaps[0] > 3 * gaps[1]
    assert len(spread(points[:20], 300)) == 20


@pytest.mark.parametrize("thinning", ["random", "farthest"])
@pytest.mark.parametrize("seed", range(3))
def test_pairs_overlap_and_agree_under_the_true_pose(seed: int, thinning: str) -> None:
    def draw() -> Pair:
        return scan_pair(
            demo_object(),
            rng(seed),
            points=800,
            min_overlap=0.4,
            thinning=thinning,  # type: ignore[arg-type]
        )

    pair = draw()
    moved = move(pair.T_target_source, pair.source)
    assert scan_overlap(moved, pair.target) >= 0.4 - 1e-3
    assert len(pair.source) == len(pair.target) == 800
    assert pair.source.tobytes() == draw().source.tobytes()


@pytest.mark.parametrize("least", [0.1, 0.3, 0.5, 0.7])
def test_pairs_overlap_no_more_than_asked(least: float) -> None:
    for seed in range(3):
        pair = scan_pair(
            demo_object(), rng(seed), points=500, min_overlap=least, max_overlap=least + 0.2
        )
        overlap = scan_overlap(move(pair.T_target_source, pair.source), pair.target)
        assert least - 1e-3 <= overlap <= least + 0.2 + 1e-3


@pytest.mark.parametrize(("scale", "shift"), [(1e-3, 0.0), (1e3, 0.0), (1.0, 1e6)])
def test_pairs_scale_and_move_with_the_object(scale: float, shift: float) -> None:
    mesh = superquadric((1.0, 0.6, 0.3), exponents=(0.5, 0.5))
    other = trimesh.Trimesh(scale * mesh.vertices + shift, mesh.faces, process=False)
    sensor = Sensor(noise=1e-3)
    here, there = (
        scan_pair(one, rng(1), points=300, min_overlap=0.3, sensor=sensor, backend="python")
        for one in (mesh, other)
    )
    assert there.T_target_source[:3, :3] == pytest.approx(here.T_target_source[:3, :3])
    for a, b in ((here.source, there.source), (here.target, there.target)):
        assert np.ptp(b, axis=0) == pytest.approx(scale * np.ptp(a, axis=0), rel=0.2)
    moved = move(there.T_target_source, there.source)
    assert cKDTree(there.target).query(moved)[0].mean() < 0.2 * scale


def test_viewpoints_see_their_clouds_from_the_asked_distance() -> None:
    pair = scan_pair(BALL, rng(), points=500, distance=(1.5, 1.6))
    for cloud, viewpoint in (
        (pair.source, pair.source_viewpoint),
        (pair.target, pair.target_viewpoint),
    ):
        assert viewpoint is not None
        center = np.linalg.lstsq(
            np.c_[2 * cloud, np.ones(len(cloud))], (cloud**2).sum(axis=1), rcond=None
        )[0][:3]
        assert ((cloud - center) @ (viewpoint - center) > 0).all()
        radii = np.linalg.norm(viewpoint - center) / mesh_ball(BALL)[1]
        assert 1.49 < radii < 1.61


def test_a_sheet_is_scanned_from_where_it_can_be_seen() -> None:
    sheet = trimesh.Trimesh(
        [[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False
    )
    for seed in range(4):
        pair = scan_pair(sheet, rng(seed), points=200)
        for cloud in (pair.source, pair.target):
            assert np.linalg.svd(cloud - cloud.mean(axis=0), compute_uv=False)[2] < 1e-9
            assert 100 <= len(cloud) <= 200


def test_overlap_of_equal_and_distant_clouds() -> None:
    points = sample_surface(demo_object(), 500, rng())
    assert scan_overlap(points, points) == 1.0
    assert scan_overlap(points, points + 10.0) == 0.0


def test_errors_are_named(unchecked: None) -> None:
    with pytest.raises(InputError, match="lower min_overlap"):
        scan_pair(box((1, 1, 1)), rng(), points=100, min_overlap=1.0, tries=1)
    with pytest.raises(InputError, match=r"at most max_overlap, 0\.3, got 0\.4"):
        scan_pair(BALL, rng(), min_overlap=0.4, max_overlap=0.3)
    for distance in ((1.0, 2.0), (3.0, 2.0), (2.0, np.inf)):
        with pytest.raises(InputError, match="range above 1 radius"):
            scan_pair(BALL, rng(), distance=distance)
    with pytest.raises(InputError, match="random or farthest"):
        scan_pair(BALL, rng(), thinning="even")  # type: ignore[arg-type]
    for wrong in ({"points": 1}, {"tries": 0}):
        with pytest.raises(InputError, match="at least 2 points and 1 try"):
            scan_pair(BALL, rng(), **wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="mesh with faces"):
        scan_pair(trimesh.Trimesh(np.eye(3), process=False), rng())
