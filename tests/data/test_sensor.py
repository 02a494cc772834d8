from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.ndimage import binary_dilation

from fullturn.data.camera import Camera, cameras_around, look_at
from fullturn.data.procedural import demo_object
from fullturn.data.raycast import DepthImage, Raycaster, mesh_ball
from fullturn.data.sensor import Sensor, sense
from fullturn.data.solids import box, join
from fullturn.errors import InputError

ALL = Sensor(noise=1e-3, quantize=1e-3, grazing_deg=30.0, flying=0.5, holes=2)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def wall(distance: float, *, tilt_deg: float = 0.0) -> tuple[DepthImage, Camera, trimesh.Trimesh]:
    """A wall that fills the image, and is turned away from the camera by an angle."""
    mesh = trimesh.Trimesh(
        np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]]) * 40.0,
        [[0, 1, 2], [0, 2, 3]],
        process=False,
    )
    tilt = np.deg2rad(tilt_deg)
    eye = distance * np.array([np.sin(tilt), -np.cos(tilt), 0.0])
    camera = look_at(eye, np.zeros(3), fov_deg=4.0)
    return Raycaster(mesh).image(camera), camera, mesh


def teapot(scale: float = 1.0) -> tuple[DepthImage, Camera, trimesh.Trimesh]:
    mesh = demo_object()
    mesh = trimesh.Trimesh(scale * mesh.vertices, mesh.faces, process=False)
    center, radius = mesh_ball(mesh)
    camera = cameras_around(center, radius, count=1, distance=3.0, rng=rng(5))[0]
    return Raycaster(mesh, backend="python").image(camera), camera, mesh


def test_nothing_is_on_by_default() -> None:
    image, camera, mesh = teapot()
    sensed = sense(image, camera, mesh, Sensor(), rng=rng())
    assert np.array_equal(sensed.depth, image.depth)
    assert np.array_equal(sensed.face, image.face)


@pytest.mark.parametrize("distance", [1.0, 3.0])
@pytest.mark.parametrize("radius", [1.0, 0.5])
def test_noise_grows_with_the_square_of_depth(distance: float, radius: float) -> None:
    image, camera, mesh = wall(distance)
    sensed = sense(image, camera, mesh, Sensor(noise=1e-3), rng=rng(), radius=radius)
    error = sensed.depth - image.depth
    assert error.std() == pytest.approx(1e-3 * distance**2 / radius, rel=0.02)
    assert abs(error.mean()) < 0.03 * error.std()


def test_disparity_comes_in_even_steps() -> None:
    image, camera, mesh = teapot()
    radius = mesh_ball(mesh)[1]
    sensed = sense(image, camera, mesh, Sensor(quantize=0.01), rng=rng())
    seen = image.face >= 0
    steps = radius / sensed.depth[seen] / 0.01
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    error = np.abs(sensed.depth[seen] - image.depth[seen]) / radius
    half = 0.5 * 0.01 * (image.depth[seen] / radius) ** 2
    assert (error < 1.05 * half).all()
    assert error.max() > 0.9 * half.min()


def test_depth_comes_in_even_steps() -> None:
    image, camera, mesh = teapot()
    radius = mesh_ball(mesh)[1]
    sensor = Sensor(quantize=0.05, quantize_what="depth")
    sensed = sense(image, camera, mesh, sensor, rng=rng())
    seen = image.face >= 0
    steps = sensed.depth[seen] / radius / 0.05
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    error = np.abs(sensed.depth[seen] - image.depth[seen]) / radius
    assert 0.02 < error.max() <= 0.025 * (1 + 1e-9)


@pytest.mark.parametrize("angle_deg", [5.0, 15.0, 29.0, 31.0, 60.0, 88.0])
def test_returns_get_lost_at_flat_angles(angle_deg: float) -> None:
    image, camera, mesh = wall(1.0, tilt_deg=90.0 - angle_deg)
    sensed = sense(image, camera, mesh, Sensor(grazing_deg=30.0), rng=rng())
    rays = camera.rays() @ camera.T_camera_object[:3, :3]
    sine = np.abs(rays[..., 1]) / np.linalg.norm(rays, axis=2)
    stays = np.minimum(sine / np.sin(np.deg2rad(30.0)), 1.0).mean()
    assert np.isfinite(sensed.depth).mean() == pytest.approx(stays, abs=0.015)
    if angle_deg > 34.0:
        assert np.array_equal(sensed.depth, image.depth)


def test_flying_pixels_land_between_two_surfaces() -> None:
    front, back = box((1, 0.1, 1), (0, -1, 0)), box((6, 0.1, 6), (0, 1, 0))
    mesh = join([front, back])
    camera = look_at(np.array([0, -5.0, 0]), np.zeros(3), fov_deg=30.0)
    image = Raycaster(mesh).image(camera)
    near, far = 3.95, 5.95
    assert set(np.round(image.depth.ravel(), 9)) == {near, far}
    sensed = sense(image, camera, mesh, Sensor(flying=0.4), rng=rng())
    moved = sensed.depth != image.depth
    is_front = image.depth < 5.0
    cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=bool)
    rim = binary_dilation(is_front, cross) & binary_dilation(~is_front, cross)
    assert not moved[~rim].any()
    assert moved[rim].mean() == pytest.approx(0.4, abs=0.1)
    between = (sensed.depth[moved] - near) / (far - near)
    assert between.min() >= 0.0
    assert between.max() <= 1.0
    assert np.histogram(between, 4, (0, 1))[0].min() > 0.1 * moved.sum()
    assert np.array_equal(sensed.face, image.face)


def test_no_pixel_flies_off_to_where_nothing_is() -> None:
    image = Raycaster(box((1, 0.1, 1))).image(
        camera := look_at(np.array([0, -5.0, 0]), np.zeros(3), fov_deg=30.0)
    )
    sensed = sense(image, camera, box((1, 0.1, 1)), Sensor(flying=1.0), rng=rng())
    assert np.array_equal(sensed.depth, image.depth)


@pytest.mark.parametrize("holes", [1, 3])
def test_holes_are_patches_of_the_size_asked_for(holes: int) -> None:
    image, camera, mesh = wall(1.0)
    areas = []
    for seed in range(12):
        sensor = Sensor(holes=holes, hole_radius=0.004)
        sensed = sense(image, camera, mesh, sensor, rng=rng(seed), radius=1.0)
        lost = np.isinf(sensed.depth)
        assert np.array_equal(lost, sensed.face == -1)
        areas.append(lost.sum() / (np.pi * (0.004 * camera.focal) ** 2))
    # Patches overlap, and some of each lies beyond the image.
    assert 0.6 * holes < np.mean(areas) < 1.1 * holes


def test_effects_leave_one_another_alone() -> None:
    image, camera, mesh = teapot()
    noisy = sense(image, camera, mesh, Sensor(noise=1e-3), rng=rng()).depth
    both = sense(image, camera, mesh, Sensor(noise=1e-3, holes=2, grazing_deg=20), rng=rng()).depth
    left = np.isfinite(both)
    assert 0.3 * np.isfinite(noisy).sum() < left.sum() < np.isfinite(noisy).sum()
    assert np.array_equal(both[left], noisy[left])


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_what_is_sensed_scales_with_the_object(scale: float) -> None:
    plain = sense(*teapot(), ALL, rng=rng())
    scaled = sense(*teapot(scale), ALL, rng=rng())
    same = plain.face == scaled.face
    assert same.mean() > 0.999
    seen = same & (plain.face >= 0)
    # A rounding error may put a depth on the next step.
    off = np.abs(scaled.depth[seen] / scale / plain.depth[seen] - 1.0)
    assert np.mean(off > 1e-9) < 1e-3


def test_the_same_seed_gives_the_same_image() -> None:
    parts = teapot()
    before = parts[0].depth.copy()
    a, b = (sense(*parts, ALL, rng=rng(1)) for _ in range(2))
    assert a.depth.tobytes() == b.depth.tobytes()
    assert sense(*parts, ALL, rng=rng(2)).depth.tobytes() != a.depth.tobytes()
    assert np.array_equal(parts[0].depth, before)
    assert np.array_equal(np.isfinite(a.depth), a.face >= 0)
    assert not (parts[0].face < 0)[a.face >= 0].any()


def test_an_empty_image_stays_empty() -> None:
    _, camera, mesh = teapot()
    nothing = DepthImage(np.full((160, 160), np.inf), np.full((160, 160), -1))
    assert np.isinf(sense(nothing, camera, mesh, ALL, rng=rng()).depth).all()


def test_impossible_depths_are_lost() -> None:
    image, camera, mesh = wall(1.0)
    sensed = sense(image, camera, mesh, Sensor(noise=2.0), rng=rng(), radius=1.0)
    assert 0.2 < np.isinf(sensed.depth).mean() < 0.4
    assert (sensed.depth > 0.0).all()
    coarse = sense(image, camera, mesh, Sensor(quantize=10.0), rng=rng(), radius=1.0)
    assert np.isinf(coarse.depth).all()


def test_all_that_is_out_of_range_is_named() -> None:
    with pytest.raises(InputError) as error:
        Sensor(noise=-1.0, quantize=np.nan, grazing_deg=91.0, flying=1.5, holes=-1, hole_radius=-1)
    for name in ("noise", "quantize", "grazing_deg", "flying", "holes", "hole_radius"):
        assert f"{name} " in str(error.value)


def test_an_unknown_quantity_is_named(unchecked: None) -> None:
    with pytest.raises(InputError, match="quantize_what of"):
        Sensor(quantize_what="time")  # type: ignore[arg-type]
