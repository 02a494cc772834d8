"""Refinement on grids brings perturbed poses back, one by one or together, from either side."""

from __future__ import annotations

import pytest
import torch
from pose_shapes import perturbations, pose_error, random_motions, teapot
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.pose.grid import NearestGrid
from fullturn.pose.refine import lay_on_points, refine_poses, tukey

H = 0.045  # about the spacing of 1,200 points on the teapot
SCALES = (3 * H,) * 4 + (2 * H,) * 4 + (1.2 * H,) * 4


def sides(
    *, missing: float = 0.0, same: bool = False
) -> tuple[Tensor, Tensor, NearestGrid, NearestGrid, Tensor]:
    """Source, target and their grids in float32, and the true pose between them."""
    T_true = random_motions(1, seed=3)[0]
    grids, clouds = [], []
    for role, seed in (("source", 1), ("target", 1 if same else 2)):
        points, normals = teapot(1200, seed)
        # Opposite sides are missing; without spout or handle it would be a body of revolution.
        height = points[:, 1] if role == "source" else -points[:, 1]
        kept = height >= height.quantile(missing)
        points, normals = points[kept], normals[kept]
        if role == "target":
            points = rigid.apply(T_true, points)
            normals = normals @ T_true[:3, :3].mT
        points, normals = points.float(), normals.float()
        clouds.append(points)
        grids.append(NearestGrid(points, normals, cell=0.5 * H, band=3 * H))
    return clouds[0], clouds[1], grids[0], grids[1], T_true


@pytest.mark.parametrize("missing", [0.0, 0.2])
def test_perturbed_poses_come_back(missing: float) -> None:
    *data, T_true = sides(missing=missing)
    start = T_true @ perturbations(16, seed=4, angle_deg=6.0, length=0.04)
    T = refine_poses(start.float(), *data, scales=SCALES)
    before, after = pose_error(start, T_true), pose_error(T, T_true)
    assert bool((after[0] < 0.5 * before[0]).all())
    assert float(after[0].median()) < 1.0
    assert float(after[1].median()) < 0.3 * H


def test_the_truth_stays_where_it_is() -> None:
    *data, T_true = sides(same=True)
    T = refine_poses(T_true.float()[None], *data, scales=SCALES)
    angle, offset = pose_error(T, T_true)
    assert float(angle) < 0.1
    assert float(offset) < 0.05 * H


def test_a_batch_equals_the_loop_and_poses_stay_rigid() -> None:
    *data, T_true = sides()
    start = (T_true @ perturbations(5, seed=5, angle_deg=5.0, length=0.03)).float()
    together = refine_poses(start, *data, scales=SCALES)
    for one, T in zip(start, together, strict=True):
        alone = refine_poses(one[None], *data, scales=SCALES)[0]
        torch.testing.assert_close(alone, T, atol=2e-3, rtol=0)
    R = together[:, :3, :3].double()
    torch.testing.assert_close(R @ R.mT, torch.eye(3).double().expand(5, 3, 3), atol=1e-5, rtol=0)
    assert torch.equal(together[:, 3], torch.tensor([0.0, 0, 0, 1]).expand(5, 4))


def test_swapping_the_clouds_inverts_the_pose() -> None:
    source, target, source_grid, target_grid, T_true = sides()
    start = (T_true @ perturbations(4, seed=6, angle_deg=4.0, length=0.03)).float()
    there = refine_poses(start, source, target, source_grid, target_grid, scales=SCALES)
    back = refine_poses(
        rigid.invert(start), target, source, target_grid, source_grid, scales=SCALES
    )
    angle, offset = pose_error(rigid.invert(back), there.double())
    assert float(angle.max()) < 0.2
    assert float(offset.max()) < 0.1 * H


def test_poses_without_partners_do_not_move() -> None:
    *data, _ = sides()
    away = torch.eye(4).repeat(2, 1, 1)
    away[:, 0, 3] = torch.tensor([30.0, -30.0])
    assert torch.equal(refine_poses(away, *data, scales=SCALES), away)


def test_tukey() -> None:
    lengths = torch.tensor([0.0, 0.5, 1.0, 2.0, 5.0])
    along = torch.nn.functional.pad(lengths[:, None], (0, 2))
    expected = torch.tensor([1.0, (1 - 0.25 / 4) ** 2, (1 - 0.25) ** 2, 0.0, 0.0])
    torch.testing.assert_close(tukey(along.T, 2.0), expected)


def test_poses_that_lay_points_on_points_become_exact() -> None:
    points = teapot(900, 1)[0].float()
    T_true = random_motions(1, seed=2)[0].float()
    target = rigid.apply(T_true, points[200:])
    grid = NearestGrid(target, torch.zeros_like(target), cell=0.05, band=0.1)
    off = perturbations(4, seed=3, angle_deg=0.1, length=1e-3).float()
    found = lay_on_points(T_true @ off, points, grid, close=0.01)
    error = (rigid.apply(found, points) - rigid.apply(T_true, points)).norm(dim=-1)
    assert float(error.max()) < 2e-6


def test_other_poses_are_not_laid_on_points() -> None:
    points, others = (teapot(900, seed)[0].float() for seed in (1, 2))
    grid = NearestGrid(others, torch.zeros_like(others), cell=0.05, band=0.1)
    T = torch.cat([torch.eye(4)[None], random_motions(3, seed=4).float()])
    assert torch.equal(lay_on_points(T, points, grid, close=0.005), T)
