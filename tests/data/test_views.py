from __future__ import annotations

import numpy as np
import pytest
import trimesh

from fullturn.data.procedural import demo_object
from fullturn.data.raycast import back_project, mesh_ball, to_object
from fullturn.data.sensor import Sensor
from fullturn.data.solids import box, superquadric
from fullturn.data.views import RangeView, view_mesh, with_plane
from fullturn.errors import InputError
from fullturn.geometry.motion import invert, move

SMALL = {"width": 48, "height": 48}


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def all_views(mesh: trimesh.Trimesh, *, seed: int = 0, **options: object) -> list[RangeView]:
    return list(view_mesh(mesh, **{"views": 5, **SMALL, **options}, rng=rng(seed)))


def test_points_lie_on_the_object_in_both_frames() -> None:
    cube = box((2, 2, 2), (5, 0, 1))
    for view in all_views(cube):
        assert len(view.points_object) > 300
        offset = np.abs(view.points_object - [5, 0, 1]).max(axis=1)
        np.testing.assert_allclose(offset, 1.0, atol=1e-12)
        moved = move(view.camera.T_camera_object, view.points_object)
        np.testing.assert_allclose(moved, view.points_camera, atol=1e-12)
        assert np.array_equal(view.points_object, to_object(view.points_camera, view.camera))
        assert np.array_equal(view.points_camera, back_project(view.image.depth, view.camera))
        assert not view.on_plane.any()


def test_all_sides_are_seen_and_only_from_outside() -> None:
    ball = superquadric((1, 1, 1), sections=80)
    views = all_views(ball, views=26)
    for view in views:
        # Visible where the tangent plane leaves the camera outside, 3 radii away.
        toward = view.camera.center / np.linalg.norm(view.camera.center)
        assert (view.points_object @ toward).min() > 1 / 3 - 0.05
    everywhere = np.concatenate([view.points_object for view in views])
    directions = rng().normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert (directions @ everywhere.T).max(axis=1).min() > np.cos(np.deg2rad(6.0))


@pytest.mark.parametrize("thinning", ["random", "farthest"])
def test_views_have_at_most_so_many_points(thinning: str) -> None:
    full = all_views(demo_object())
    for some, view in zip(
        all_views(demo_object(), points=200, thinning=thinning), full, strict=True
    ):
        assert len(some.points_camera) == len(some.on_plane) == 200 < len(view.points_camera)
        assert {*map(tuple, some.points_camera)} < {*map(tuple, view.points_camera)}
        assert np.array_equal(some.image.depth, view.image.depth)
    many = all_views(demo_object(), points=10**6)
    assert np.array_equal(many[0].points_camera, full[0].points_camera)


def test_the_same_seed_gives_the_same_views() -> None:
    sensor = Sensor(noise=1e-3, holes=1, flying=0.2)
    a, b = (all_views(demo_object(), points=100, sensor=sensor) for _ in range(2))
    c = all_views(demo_object(), points=100, sensor=sensor, seed=1)
    for first, second, third in zip(a, b, c, strict=True):
        assert first.points_object.tobytes() == second.points_object.tobytes()
        assert first.points_object.tobytes() != third.points_object.tobytes()


def test_noise_does_not_depend_on_how_many_points_are_kept() -> None:
    sensor = Sensor(noise=1e-3)
    few = all_views(demo_object(), points=50, sensor=sensor)
    full = all_views(demo_object(), sensor=sensor)
    for some, view in zip(few, full, strict=True):
        assert np.array_equal(some.image.depth, view.image.depth)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_views_scale_with_the_object(scale: float) -> None:
    mesh = demo_object()
    sensor = Sensor(noise=1e-3)
    larger = trimesh.Trimesh(scale * mesh.vertices, mesh.faces, process=False)
    for a, b in zip(
        all_views(mesh, sensor=sensor, backend="python"),
        all_views(larger, sensor=sensor, backend="python"),
        strict=True,
    ):
        np.testing.assert_allclose(
            b.points_object, scale * a.points_object, rtol=0, atol=1e-9 * scale
        )


def test_far_from_the_origin_nothing_changes() -> None:
    mesh = demo_object()
    far = trimesh.Trimesh(mesh.vertices + 1e6, mesh.faces, process=False)
    for a, b in zip(all_views(mesh), all_views(far), strict=True):
        assert abs(len(a.points_camera) - len(b.points_camera)) <= 1
        assert np.linalg.norm(b.camera.center - 1e6 - a.camera.center) < 1e-8
        if len(a.points_camera) == len(b.points_camera):
            np.testing.assert_allclose(a.points_camera, b.points_camera, atol=1e-6)


def test_the_object_stands_on_a_plane() -> None:
    mesh = box((1, 1, 2), (3, 0, 7))
    radius = mesh_ball(mesh)[1]
    scene = with_plane(mesh)
    assert np.array_equal(scene.faces[:-2], mesh.faces)
    views = all_views(mesh, plane=True, views=9)
    for view in views:
        assert view.camera.center[2] > 7.0
        assert np.linalg.norm(view.camera.center - [3, 0, 7]) == pytest.approx(3 * radius)
        first = int((~view.on_plane).sum())
        assert 50 < first < len(view.on_plane)
        assert view.on_plane[first:].all()
        np.testing.assert_allclose(view.points_object[first:, 2], 6.0, atol=1e-12)
        offset = np.abs((view.points_object[:first] - [3, 0, 7]) / [1, 1, 2]).max(axis=1)
        np.testing.assert_allclose(offset, 0.5, atol=1e-12)
        assert np.array_equal(
            view.points_object, move(invert(view.camera.T_camera_object), view.points_camera)
        )
    thinned = all_views(mesh, plane=True, points=60)[2]
    assert len(thinned.on_plane) == 60
    assert np.array_equal(thinned.on_plane, np.sort(thinned.on_plane))


def test_a_view_may_see_nothing() -> None:
    for view in all_views(demo_object(), sensor=Sensor(quantize=100.0), points=50):
        assert view.points_object.shape == view.points_camera.shape == (0, 3)
        assert view.on_plane.shape == (0,)
        assert np.isinf(view.image.depth).all()


def test_a_flat_object_can_be_seen() -> None:
    square = trimesh.Trimesh(
        [[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False
    )
    for plane in (False, True):
        for view in all_views(square, plane=plane):
            np.testing.assert_allclose(view.points_object[:, 2], 0.0, atol=1e-12)


def test_errors_come_at_once_and_are_named(unchecked: None) -> None:
    mesh = demo_object()
    for options in ({"views": 0}, {"points": 0}, {"width": 0}):
        with pytest.raises(InputError, match="at least 1 view"):
            view_mesh(mesh, **options, rng=rng())
    with pytest.raises(InputError, match="more than 1 radius"):
        view_mesh(mesh, distance=0.9, rng=rng())
    with pytest.raises(InputError, match="random or farthest"):
        view_mesh(mesh, thinning="none", rng=rng())  # type: ignore[arg-type]
    for plane in (False, True):
        with pytest.raises(InputError, match="mesh with faces"):
            view_mesh(trimesh.Trimesh(np.eye(3), process=False), plane=plane, rng=rng())
