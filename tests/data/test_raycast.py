from __future__ import annotations

import sys
import tracemalloc
from importlib.util import find_spec
from typing import Literal

import numpy as np
import pytest
import trimesh

from fullturn.data.camera import Camera, bounding_ball, cameras_around, look_at
from fullturn.data.motion import uniform_rotation
from fullturn.data.procedural import demo_object, dog, procedural_mesh
from fullturn.data.raycast import Raycaster, back_project, mesh_ball, to_object
from fullturn.data.solids import box, grid_surface, join, superquadric
from fullturn.errors import DependencyError, InputError
from fullturn.geometry.motion import move, rigid

Backend = Literal["embree", "python"]
needs_embree = pytest.mark.skipif(find_spec("embreex") is None, reason="needs embreex")
both = pytest.mark.parametrize("backend", [pytest.param("embree", marks=needs_embree), "python"])
EYE = np.array([1.0, -2.5, 0.8])


def soup(count: int, *, seed: int = 0) -> trimesh.Trimesh:
    """Triangles of all sizes, anywhere in the unit cube, crossing one another."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-1, 1, (count, 1, 3))
    corners = middle + rng.normal(size=(count, 3, 3)) * rng.uniform(0.02, 0.5, (count, 1, 1))
    return trimesh.Trimesh(
        corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), process=False
    )


def by_brute_force(mesh: trimesh.Trimesh, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Depth and face by solving for each pixel and triangle: s·ray = a + u (b − a) + v (c − a)."""
    a, b, c = move(camera.T_camera_object, mesh.vertices)[mesh.faces].transpose(1, 0, 2)
    rays = camera.rays().reshape(-1, 3)
    best, face = np.full(len(rays), np.inf), np.full(len(rays), -1)
    for i, ray in enumerate(rays):
        system = np.stack([np.broadcast_to(ray, a.shape), a - b, a - c], axis=2)
        solvable = np.abs(np.linalg.det(system)) > 1e-14
        s, u, v = np.linalg.solve(system[solvable], a[solvable][..., None])[..., 0].T
        inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (s > 0)
        if inside.any():
            which = np.argmin(np.where(inside, s, np.inf))
            best[i], face[i] = s[which], np.flatnonzero(solvable)[which]
    return best.reshape(camera.height, -1), face.reshape(camera.height, -1)


@both
@pytest.mark.parametrize("place", ["outside", "inside", "with faces behind"])
def test_every_pixel_is_what_brute_force_finds(backend: Backend, place: str) -> None:
    mesh = soup(60)
    eye = {"outside": EYE, "inside": np.full(3, 0.05), "with faces behind": 0.4 * EYE}[place]
    camera = look_at(eye, np.array([0.3, 0.1, 0.2]), fov_deg=90.0, width=40, height=30)
    image = Raycaster(mesh, backend=backend).image(camera)
    depth, face = by_brute_force(mesh, camera)
    assert np.mean(face >= 0) > 0.05
    assert np.mean(image.face != face) < 0.002
    same = image.face == face
    np.testing.assert_allclose(image.depth[same], depth[same], rtol=1e-9)


@needs_embree
@pytest.mark.parametrize("name", ["dog", "teapot", "soup", "procedural 1", "procedural 2"])
def test_both_backends_agree(name: str) -> None:
    kind, _, seed = name.partition(" ")
    mesh = (
        procedural_mesh(np.random.default_rng(int(seed)))
        if seed
        else {"dog": dog, "teapot": demo_object, "soup": lambda: soup(500)}[kind]()
    )
    casters = [Raycaster(mesh, backend=backend) for backend in ("embree", "python")]
    center, radius = mesh_ball(mesh)
    for camera in cameras_around(
        center, radius, count=3, distance=2.5, rng=np.random.default_rng(0)
    ):
        a, b = (caster.image(camera) for caster in casters)
        assert np.mean((a.face >= 0) != (b.face >= 0)) < 2e-4  # rims, in single precision
        seen = (a.face >= 0) & (b.face >= 0)
        same = seen & (a.face == b.face)
        np.testing.assert_allclose(a.depth[same], b.depth[same], rtol=1e-12)
        off = np.abs(a.depth[seen] / b.depth[seen] - 1.0)
        assert np.mean(off > 1e-6) < 2e-4  # where an edge hides something behind
        # Parts of an object may coincide; apart from these ties, the faces are the same.
        assert np.mean((a.face != b.face)[seen] & (off > 1e-13)) < 1e-3


@both
def test_a_box_has_its_exact_depths(backend: Backend) -> None:
    camera = look_at(np.array([3.0, 0, 0]), np.zeros(3), fov_deg=60.0, width=51, height=51)
    image = Raycaster(box((2, 1, 1)), backend=backend).image(camera)
    rays = camera.rays()
    # From the front: the near side, 2 away, where |x|, |y| ≤ 0.5 there.
    inside = (np.abs(rays[..., :2]) * 2.0 <= 0.5 - 1e-9).all(axis=2)
    np.testing.assert_allclose(image.depth[inside], 2.0, rtol=1e-15)
    assert np.isinf(image.depth[(np.abs(rays[..., :2]) * 2.0 > 0.5).any(axis=2)]).all()
    assert np.array_equal(np.isfinite(image.depth), image.face >= 0)


@both
def test_no_ray_slips_through_an_edge(backend: Backend) -> None:
    # Odd sizes: middle rows and columns, and diagonals, run exactly along edges of the grid.
    side = np.linspace(-1.0, 1.0, 9)
    x, y = np.meshgrid(side, side, indexing="ij")
    sheet = grid_surface(np.stack([x, y, 0 * x], axis=2), wrap_rows=False, wrap_columns=False)
    for eye in ([0.0, 0.0, 1.5], [0.0, 0.0, -1.5], [0.25, 0.25, 1.0], [0.5, -0.5, 1.5]):
        at = np.array([eye[0], eye[1], 0.0])
        camera = look_at(np.array(eye), at, fov_deg=30.0, width=33, height=33)
        image = Raycaster(sheet, backend=backend).image(camera)
        np.testing.assert_allclose(image.depth, abs(eye[2]), rtol=1e-12)


@both
def test_a_camera_inside_sees_the_inside(backend: Backend) -> None:
    room = box((4, 4, 2))
    for at in np.eye(3):
        camera = look_at(np.array([0.3, -0.2, 0.1]), at, fov_deg=120.0, width=30, height=20)
        image = Raycaster(room, backend=backend).image(camera)
        assert (image.face >= 0).all()
        points = to_object(back_project(image.depth, camera), camera)
        assert np.abs(np.abs(points / [2, 2, 1]).max(axis=1) - 1.0).max() < 1e-12


@both
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_images_move_with_mesh_and_camera(backend: Backend, scale: float, offset: float) -> None:
    mesh = demo_object()
    camera = look_at(EYE, np.zeros(3), width=60, height=60)
    plain = Raycaster(mesh, backend=backend).image(camera)
    motion = rigid(uniform_rotation(np.random.default_rng(1)), np.full(3, scale * offset))
    moved_mesh = trimesh.Trimesh(move(motion, scale * mesh.vertices), mesh.faces, process=False)
    T_camera_object = camera.T_camera_object.copy()
    T_camera_object[:3, 3] *= scale
    moved = Camera(T_camera_object @ np.linalg.inv(motion), camera.focal, 60, 60)
    image = Raycaster(moved_mesh, backend=backend).image(moved)
    assert np.mean(image.face != plain.face) < 2e-3
    same = (image.face == plain.face) & (image.face >= 0)
    # A coordinate near 1e6 has ten digits left; a surface seen at a flat angle loses some more.
    np.testing.assert_allclose(
        image.depth[same], scale * plain.depth[same], rtol=1e-6 if offset else 1e-10
    )


@both
def test_winding_is_of_no_importance(backend: Backend) -> None:
    mesh = demo_object()
    faces = mesh.faces.copy()
    faces[::2] = faces[::2, ::-1]
    camera = look_at(EYE, np.zeros(3), width=60, height=60)
    plain = Raycaster(mesh, backend=backend).image(camera)
    image = Raycaster(trimesh.Trimesh(mesh.vertices, faces, process=False), backend=backend).image(
        camera
    )
    assert np.mean(image.face != plain.face) < 1e-3
    seen = np.isfinite(plain.depth) & np.isfinite(image.depth)
    np.testing.assert_allclose(image.depth[seen], plain.depth[seen], rtol=1e-9)


@both
def test_degenerate_faces_are_ignored_and_still_counted(backend: Backend) -> None:
    mesh = superquadric((1, 1, 1), sections=20)
    a, b, _ = mesh.faces[0]
    flat = [[a, a, a], [a, a, b], [a, b, a]]
    camera = look_at(EYE, np.zeros(3), width=50, height=50)
    plain = Raycaster(mesh, backend=backend).image(camera)
    messy = trimesh.Trimesh(mesh.vertices, [*flat, *mesh.faces], process=False)
    image = Raycaster(messy, backend=backend).image(camera)
    assert np.array_equal(image.depth, plain.depth)
    assert np.array_equal(image.face, np.where(plain.face >= 0, plain.face + 3, -1))


def test_of_equal_faces_the_first_one_is_seen() -> None:
    mesh = superquadric((1, 1, 1), sections=20)
    twice = join([mesh, mesh])
    camera = look_at(EYE, np.zeros(3), width=50, height=50)
    image = Raycaster(twice, backend="python").image(camera)
    assert image.face.max() < len(mesh.faces)


@both
def test_an_edge_on_sheet_is_no_error(backend: Backend) -> None:
    sheet = trimesh.Trimesh(
        [[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False
    )
    for width in (20, 21):  # 21: the middle row lies in the sheet
        camera = look_at(np.array([0, -3.0, 0]), np.zeros(3), width=width, height=width)
        image = Raycaster(sheet, backend=backend).image(camera)
        seen = image.face >= 0
        assert seen.sum() <= width
        assert ((image.depth[seen] >= 2.0) & (image.depth[seen] <= 4.0)).all()


@both
@pytest.mark.parametrize("at", [[1.0, 0, 0], [0, -5.0, 9.0]])
def test_seeing_nothing_is_no_error(backend: Backend, at: list[float]) -> None:
    eye = np.array([0.0, -5.0, 0.0])
    camera = look_at(eye, eye + eye + np.array(at), fov_deg=20.0, width=30, height=20)
    image = Raycaster(demo_object(), backend=backend).image(camera)
    assert np.isinf(image.depth).all()
    assert (image.face == -1).all()
    assert back_project(image.depth, camera).shape == (0, 3)


@both
def test_points_lie_on_their_faces_and_in_their_pixels(backend: Backend) -> None:
    mesh = demo_object()
    camera = look_at(EYE, np.zeros(3), width=70, height=50)
    image = Raycaster(mesh, backend=backend).image(camera)
    points = back_project(image.depth, camera)
    seen = np.isfinite(image.depth)
    assert len(points) == seen.sum() > 200
    np.testing.assert_allclose(points / points[:, 2:], camera.rays()[seen], atol=1e-15)
    in_object = to_object(points, camera)
    np.testing.assert_allclose(move(camera.T_camera_object, in_object), points, atol=1e-14)
    corners = mesh.vertices[mesh.faces[image.face[seen]]]
    coordinates = trimesh.triangles.points_to_barycentric(corners, in_object)
    assert coordinates.min() > -1e-3
    back = (coordinates[:, :, None] * corners).sum(axis=1)
    np.testing.assert_allclose(back, in_object, atol=1e-12)


def test_a_large_mesh_takes_little_memory() -> None:
    side = np.linspace(-1.0, 1.0, 401)
    x, y = np.meshgrid(side, side, indexing="ij")
    height = 0.1 * np.sin(9 * x) * np.cos(7 * y)
    terrain = grid_surface(np.stack([x, y, height], axis=2), wrap_rows=False, wrap_columns=False)
    caster = Raycaster(terrain, backend="python")
    # Low above the ground: some faces are near and large, and some reach behind the eye.
    camera = look_at(np.array([0.2, -0.9, 0.12]), np.array([0, 1.0, 0]), fov_deg=90.0)
    tracemalloc.start()
    image = caster.image(camera)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert np.isfinite(image.depth).mean() > 0.4
    assert peak < 250e6


def test_without_embree_numpy_does_it(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("embreex", "embreex.rtcore_scene", "embreex.mesh_construction"):
        monkeypatch.setitem(sys.modules, module, None)
    assert Raycaster(box((1, 1, 1))).backend == "python"
    with pytest.raises(DependencyError, match=r"fullturn\[data\]"):
        Raycaster(box((1, 1, 1)), backend="embree")


@needs_embree
def test_embree_is_taken_where_it_is_installed() -> None:
    assert Raycaster(box((1, 1, 1))).backend == "embree"
    assert Raycaster(box((1, 1, 1)), backend="python").backend == "python"


def test_what_cannot_be_seen_is_named(unchecked: None) -> None:
    corners = np.eye(3)
    with pytest.raises(InputError, match="mesh with faces"):
        Raycaster(trimesh.Trimesh(corners, process=False))
    with pytest.raises(InputError, match="1 with NaN"):
        Raycaster(trimesh.Trimesh(np.vstack([corners, [0, np.nan, 0]]), [[0, 1, 2]], process=False))
    with pytest.raises(InputError, match="indices from 0 to 3"):
        Raycaster(trimesh.Trimesh(corners, [[0, 1, 3]], process=False))
    with pytest.raises(InputError, match="1 faces have no area"):
        Raycaster(trimesh.Trimesh(corners, [[0, 1, 1]], process=False))
    with pytest.raises(InputError, match="embree or python"):
        Raycaster(box((1, 1, 1)), backend="opengl")  # type: ignore[arg-type]


def test_the_ball_is_around_the_faces() -> None:
    mesh = trimesh.Trimesh(np.vstack([np.eye(3), [[9.0, 9, 9]]]), [[0, 1, 2]], process=False)
    center, radius = mesh_ball(mesh)
    assert np.array_equal(center, bounding_ball(np.eye(3))[0])
    assert radius == bounding_ball(np.eye(3))[1]
