"""Planes that are too large for the model, parts in which it may be, what a sensor saw."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from locate_scenes_of import uneven_ground
from scipy.spatial.transform import Rotation

from fullturn.geometry import rigid
from fullturn.geometry.sampling import voxel_sample
from fullturn.locating.planes import extent, large_planes
from fullturn.locating.regions import regions
from fullturn.locating.sight import Sight
from fullturn.locating.visible import best_views, nearest_views


def on_floor(rng: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """A floor of 6 × 6 with a ball of radius 1 on it, noisy; True on the floor."""
    floor = np.column_stack([rng.uniform(-3, 3, (9000, 2)), np.zeros(9000)])
    ball = trimesh.sample.sample_surface(trimesh.creation.icosphere(), 3000, seed=0)[0]
    points = np.vstack([floor, np.asarray(ball) + np.array([0, 0, 1.2])])
    points += 0.004 * rng.normal(size=points.shape)
    return torch.from_numpy(points), torch.arange(len(points)) < len(floor)


@pytest.mark.parametrize("eye", [None, (0.0, -3.0, 4.0)])
def test_a_floor_is_found_in_any_frame(eye: tuple[float, float, float] | None) -> None:
    points, floor = on_floor(np.random.default_rng(0))
    R = torch.from_numpy(Rotation.random(random_state=1).as_matrix())
    viewpoint = None if eye is None else torch.tensor(eye).double() @ R.T + 1.0
    planes = large_planes(points @ R.T + 1.0, diameter=2.0, spacing=0.05, viewpoint=viewpoint)
    assert len(planes) == 1
    assert bool(planes[0].members[floor].float().mean() > 0.97)
    assert not bool(planes[0].members[~floor].any())
    torch.testing.assert_close(planes[0].normal, R[:, 2], atol=0.01, rtol=0.0)
    height = planes[0].height(points @ R.T + 1.0)
    torch.testing.assert_close(height, points[:, 2], atol=0.03, rtol=0.0)


def test_a_plane_that_the_model_may_have_is_left() -> None:
    points, _ = on_floor(np.random.default_rng(0))
    assert large_planes(points, diameter=8.0, spacing=0.05, viewpoint=None) == []


@pytest.mark.parametrize("shape", [trimesh.creation.box((1, 1, 1)), trimesh.creation.icosphere(2)])
def test_objects_in_a_row_are_no_plane(shape: trimesh.Trimesh) -> None:
    """Their faces lie in planes that reach far, and so do the cuts through them."""
    one = np.asarray(trimesh.sample.sample_surface(shape, 2000, seed=0)[0])
    row = torch.from_numpy(np.concatenate([one + np.array([3.0 * k, 0, 0]) for k in range(4)]))
    assert large_planes(row, diameter=2.0, spacing=0.05, viewpoint=None) == []


def test_parts_are_pieces_and_what_is_near_them() -> None:
    ball = torch.from_numpy(
        np.asarray(trimesh.sample.sample_surface(trimesh.creation.icosphere(), 2000, seed=0)[0])
    )
    whole = torch.cat([ball, ball + torch.tensor([4.0, 0, 0])])
    every = torch.ones(len(whole), dtype=torch.bool)
    told = {"diameter": 2.0, "spacing": 0.08, "limit": 5}
    found = regions(whole, every, **told)  # type: ignore[arg-type]
    assert [int(mask.sum()) for mask in found] == [2000, 2000]
    assert not bool((found[0] & found[1]).any())
    # One that a shadow cuts in two stays one.
    cut = ball[(ball[:, 0] - 0.1).abs() > 0.15]
    together = regions(cut, torch.ones(len(cut), dtype=torch.bool), **told)  # type: ignore[arg-type]
    assert [int(mask.sum()) for mask in together] == [len(cut)]
    assert regions(whole, torch.zeros_like(every), **told) == []  # type: ignore[arg-type]


def ground_points() -> torch.Tensor:
    mesh = uneven_ground(4.0, 0.15)
    return torch.from_numpy(np.asarray(trimesh.sample.sample_surface(mesh, 20_000, seed=0)[0]))


def test_what_is_far_larger_than_the_model_comes_in_balls_that_hold_it() -> None:
    ground = ground_points()
    every = torch.ones(len(ground), dtype=torch.bool)
    found = regions(ground, every, diameter=2.0, spacing=0.06, limit=1000)
    assert 20 < len(found) < 120
    assert all(extent(ground[part]) < 3.01 for part in found)
    for place in ground[::400]:
        near = (ground - place).norm(dim=1) < 0.5
        assert any(bool(part[near].all()) for part in found)
    assert len(regions(ground, every, diameter=6.0, spacing=0.06, limit=1000)) == 1


def test_far_from_a_found_model_parts_stay_as_they_were() -> None:
    ground = ground_points()
    taken = (ground - ground[7]).norm(dim=1) < 1.0
    before, after = (
        regions(ground, free, diameter=2.0, spacing=0.06, limit=1000)
        for free in (torch.ones_like(taken), ~taken)
    )
    stayed = {part.numpy().tobytes() for part in after}
    far = [part for part in before if not bool((part & taken).any())]
    assert len(far) > 10
    assert all(part.numpy().tobytes() in stayed for part in far)


def test_the_extent_is_about_the_diameter() -> None:
    points = torch.from_numpy(np.random.default_rng(0).normal(size=(200, 3)))
    brute = float(torch.cdist(points, points).amax())
    assert 0.9 * brute < extent(points) <= brute


def test_a_sensor_sees_past_before_nothing_and_not_behind() -> None:
    wall, _ = voxel_sample(torch.rand(40_000, 3, generator=torch.Generator().manual_seed(0)), 0.02)
    wall = (wall - 0.5) * torch.tensor([1.0, 1.0, 0.0])
    sight = Sight(wall, torch.tensor([0.0, 0.0, 3.0]), pixel=0.05, margin=0.05)
    points = torch.tensor([[[0.0, 0, 0.5], [0, 0, 0.01], [0, 0, -0.5], [0.55, 0.55, 0.1]]])
    past, empty, hidden = sight.contradictions(points, torch.ones(1, 4, dtype=torch.bool))
    assert past.tolist() == [[True, False, False, False]]
    assert empty.tolist() == [[False, False, False, True]]
    assert hidden.tolist() == [[False, False, True, False]]


def test_a_sensor_sees_the_near_half_of_a_ball_at_any_pose() -> None:
    ball = torch.from_numpy(trimesh.creation.icosphere(subdivisions=4).vertices).float()
    eye = torch.tensor([0.0, 0.0, 3.0])
    sight = Sight(ball, eye, pixel=0.12, margin=0.1)
    R = rigid.exp_so3(torch.randn(3, 3, generator=torch.Generator().manual_seed(0)))
    T = rigid.make(R, torch.zeros(3, 3))
    seen = sight.visible(T, ball, ball)
    toward = ((ball @ R.mT) @ eye) / 3.0
    assert bool(seen[toward > 0.5].all())
    assert not bool(seen[toward < 0.25].any())


def test_the_best_view_is_the_one_that_sees_what_has_partners() -> None:
    generator = torch.Generator().manual_seed(0)
    seen = torch.rand(8, 300, generator=generator) < 0.4
    noisy = seen.float()
    noisy[:, ::10] = 0.5
    assert best_views(noisy, torch.ones(300), seen).tolist() == list(range(8))
    axes = torch.eye(3)
    assert nearest_views(axes[[2, 0]] + 0.1, axes).tolist() == [2, 0]
