from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fullturn.data.camera import Camera, bounding_ball, cameras_around, look_at
from fullturn.errors import InputError
from fullturn.geometry.directions import sphere_directions
from fullturn.geometry.motion import move

ORIGIN = np.zeros(3)
EYES = {
    "side": np.array([0.0, -3.0, 0.0]),
    "oblique": np.array([1.0, 2.0, -0.5]),
    "above": np.array([0.0, 0.0, 5.0]),
    "below": np.array([0.0, 0.0, -5.0]),
    "nearly above": np.array([1e-9, 0.0, 5.0]),
    "millimeters": np.array([1.0, -2.0, 0.5]) * 1e-3,
    "kilometers": np.array([1.0, -2.0, 0.5]) * 1e3,
}


def pixels(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Where points of the object's frame appear: (u, v), whole numbers in pixel centers."""
    x, y, z = move(camera.T_camera_object, points).T
    u = camera.focal * x / z + camera.width / 2 - 0.5
    return np.stack([u, camera.focal * y / z + camera.height / 2 - 0.5], axis=1)


@pytest.mark.parametrize("eye", EYES.values(), ids=EYES.keys())
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_the_point_looked_at_is_straight_ahead(eye: np.ndarray, offset: float) -> None:
    at = np.full(3, offset)
    camera = look_at(at + eye, at)
    R = camera.T_camera_object[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0)
    slack = 1e-9 * offset + 1e-14 * np.linalg.norm(eye)
    np.testing.assert_allclose(camera.center, at + eye, atol=slack)
    ahead = move(camera.T_camera_object, at[None])[0]
    np.testing.assert_allclose(ahead, [0, 0, np.linalg.norm(eye)], atol=slack)


@pytest.mark.parametrize("name", ["side", "oblique", "millimeters"])
def test_z_is_up_in_the_image(name: str) -> None:
    eye = EYES[name]
    camera = look_at(eye, ORIGIN)
    low, high = pixels(camera, np.array([[0, 0, -0.1], [0, 0, 0.1]]) * np.linalg.norm(eye))
    assert high[1] < low[1]
    assert high[0] == pytest.approx(low[0])


@pytest.mark.parametrize(("width", "height"), [(4, 4), (5, 3), (1, 1), (320, 240)])
def test_rays_go_through_their_pixels(width: int, height: int) -> None:
    camera = look_at(EYES["oblique"], ORIGIN, width=width, height=height)
    rays = camera.rays()
    assert rays.shape == (height, width, 3)
    np.testing.assert_allclose(rays.mean(axis=(0, 1)), [0, 0, 1], atol=1e-12)
    inverse = np.linalg.inv(camera.T_camera_object)
    seen = pixels(camera, move(inverse, 7.0 * rays.reshape(-1, 3))).reshape(height, width, 2)
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    np.testing.assert_allclose(seen, np.stack([column, row], axis=2), atol=1e-9)


@pytest.mark.parametrize(("width", "height"), [(160, 160), (320, 240), (120, 200)])
def test_the_field_of_view_spans_the_shorter_side(width: int, height: int) -> None:
    camera = look_at(EYES["side"], ORIGIN, fov_deg=90.0, width=width, height=height)
    assert camera.focal == pytest.approx(min(width, height) / 2)


@pytest.mark.parametrize("count", [1, 2, 26, 200, 2000])
def test_directions_are_evenly_spread(count: int) -> None:
    directions = sphere_directions(count)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    if count < 26:
        return
    assert np.linalg.norm(directions.mean(axis=0)) < 0.02
    even = np.sqrt(4 * np.pi / count)  # side of the square that each has to itself
    nearest = cKDTree(directions).query(directions, k=2)[0][:, 1]
    assert nearest.min() > 0.7 * even
    anywhere = np.random.default_rng(0).normal(size=(5000, 3))
    anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
    assert cKDTree(directions).query(anywhere)[0].max() < 1.1 * even


@pytest.mark.parametrize(("width", "height"), [(160, 160), (320, 240)])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_the_image_just_holds_the_ball(width: int, height: int, scale: float) -> None:
    center, radius = scale * np.array([5.0, -2.0, 1.0]), 0.7 * scale
    rng = np.random.default_rng(3)
    cameras = cameras_around(
        center, radius, count=9, distance=2.5, rng=rng, width=width, height=height
    )
    assert len(cameras) == 9
    ball = center + radius * sphere_directions(20_000)
    for camera in cameras:
        assert np.linalg.norm(camera.center - center) == pytest.approx(2.5 * radius)
        seen = pixels(camera, ball)
        limits = np.array([width, height])
        assert (seen > -0.5 - 1e-6).all()
        assert (seen < limits - 0.5 + 1e-6).all()
        np.testing.assert_allclose(np.ptp(seen, axis=0), min(width, height), rtol=0.01)


def test_the_lattice_is_turned_at_random() -> None:
    def eyes(seed: int, above: bool) -> np.ndarray:
        rng = np.random.default_rng(seed)
        cameras = cameras_around(ORIGIN, 1.0, count=26, distance=3.0, rng=rng, above=above)
        return np.stack([camera.center for camera in cameras]) / 3.0

    for above in (False, True):
        assert np.array_equal(eyes(0, above), eyes(0, above))
        assert np.abs(eyes(0, above) - eyes(1, above)).max() > 0.1
        # One rotation: the angles between the directions stay.
        gram = [eyes(seed, above) @ eyes(seed, above).T for seed in (0, 1)]
        np.testing.assert_allclose(gram[0], gram[1], atol=1e-12)
    assert eyes(0, False)[:, 2].min() < -0.5
    heights = np.sort(eyes(0, True)[:, 2])
    np.testing.assert_allclose(heights, (2 * np.arange(26) + 1) / 52, atol=1e-12)


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_the_bounding_ball_holds_all_points(offset: float) -> None:
    points = np.random.default_rng(0).normal(size=(100, 3)) + offset
    center, radius = bounding_ball(points)
    distance = np.linalg.norm(points - center, axis=1)
    assert distance.max() == radius
    assert bounding_ball(points[:1])[1] == 0.0


def test_what_is_no_camera_is_named() -> None:
    with pytest.raises(InputError, match="another, finite point"):
        look_at(ORIGIN, ORIGIN)
    with pytest.raises(InputError, match="another, finite point"):
        look_at(ORIGIN, np.array([np.nan, 0, 0]))
    for fov_deg in (0.0, 180.0, np.nan):
        with pytest.raises(InputError, match="between 0° and 180°"):
            look_at(EYES["side"], ORIGIN, fov_deg=fov_deg)
    with pytest.raises(InputError, match="rigid"):
        Camera(2.0 * np.eye(4), 100.0, 10, 10)
    with pytest.raises(InputError, match="rigid"):
        Camera(np.diag([1.0, 1.0, -1.0, 1.0]), 100.0, 10, 10)
    for focal, width in ((0.0, 10), (np.inf, 10), (100.0, 0)):
        with pytest.raises(InputError, match="focal length above 0"):
            Camera(np.eye(4), focal, width, 10)


def test_what_cannot_be_surrounded_is_named() -> None:
    rng = np.random.default_rng(0)
    for distance in (1.0, 0.5, np.inf, np.nan):
        with pytest.raises(InputError, match="more than 1 radius"):
            cameras_around(ORIGIN, 1.0, count=3, distance=distance, rng=rng)
    with pytest.raises(InputError, match="radius above 0"):
        cameras_around(ORIGIN, 0.0, count=3, distance=3.0, rng=rng)
    for above in (False, True):
        with pytest.raises(InputError, match="at least 1 direction"):
            cameras_around(ORIGIN, 1.0, count=0, distance=3.0, rng=rng, above=above)
