"""The last refinement: exact where the clouds are, robust where they aren't, aware of noise."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from pose_shapes import perturbations, pose_error, random_motions, teapot
from torch import Tensor

from fullturn.data.draw import ProtocolPairs
from fullturn.data.protocols import PROTOCOLS
from fullturn.data.shapes import ProceduralShapes
from fullturn.geometry import rigid
from fullturn.geometry.cloud import Cloud
from fullturn.geometry.sampling import farthest_point_sample
from fullturn.pose.closest_pairs import ClosestPairs, Residuals
from fullturn.pose.fine import refine_fine

T_TRUE = random_motions(1, seed=5)[0]


def clouds(
    count: int,
    *,
    noise: float = 0.0,
    same: bool = True,
    missing: float = 0.0,
    seed: int = 0,
    T: Tensor = T_TRUE,
) -> tuple[Cloud, Cloud]:
    """Two clouds of the teapot, cut on opposite sides; `same` points or independent ones."""
    rng = np.random.default_rng(seed)
    parts = []
    for side, draw in ((1.0, 2 * seed + 1), (-1.0, 2 * seed + (1 if same else 2))):
        points, _ = teapot(count, draw)
        height = side * points[:, 1]
        points = points[height >= height.quantile(missing)]
        points = points[torch.from_numpy(rng.permutation(len(points)))]
        parts.append(points + noise * torch.from_numpy(rng.normal(size=points.shape)))
    return Cloud(parts[0]), Cloud(rigid.apply(T, parts[1]))


def residuals_at(T: Tensor, source: Cloud, target: Cloud, *, cutoff: float) -> Residuals:
    return ClosestPairs(source, target).residuals(T.numpy(), cutoff=cutoff)


def refined(source: Cloud, target: Cloud, T: Tensor) -> Tensor:
    start = 2 * max(source.spacing, target.spacing)
    return refine_fine(T, source, target, start=start)


@pytest.mark.parametrize("missing", [0.0, 0.3])
@pytest.mark.parametrize(
    ("angle_deg", "length"), [(0.0, 0.0), (1e-5, 1e-7), (0.1, 1e-3), (1, 0.01)]
)
def test_the_same_points_are_laid_on_each_other_exactly(
    missing: float, angle_deg: float, length: float
) -> None:
    source, target = clouds(800, missing=missing)
    for shift in perturbations(3, seed=1, angle_deg=angle_deg, length=length):
        angle, offset = pose_error(refined(source, target, T_TRUE @ shift), T_TRUE)
        assert float(angle.deg2rad()) < 1e-6
        assert float(offset) < 1e-6


def test_every_kind_of_shape_is_laid_on_itself_exactly() -> None:
    shapes = ProceduralShapes(60, seed=3)
    for pair in ProtocolPairs(PROTOCOLS["modelnet40/clean/180"], shapes, count=16, seed=1):
        source, target = (torch.from_numpy(x) for x in (pair.source, pair.target))
        T_true = torch.from_numpy(pair.T_target_source)
        for shift in (0.0, 2e-3):
            start = T_true @ perturbations(1, seed=2, angle_deg=57 * shift, length=shift)[0]
            angle, offset = pose_error(refined(Cloud(source), Cloud(target), start), T_true)
            assert float(angle.deg2rad()) < 1e-6, pair.name
            assert float(offset) < 1e-6, pair.name


@pytest.mark.parametrize("missing", [0.0, 0.3])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_independent_points_are_brought_close(missing: float, noise: float) -> None:
    errors = []
    for seed in range(3):
        source, target = clouds(1500, same=False, missing=missing, noise=noise, seed=seed)
        for shift in perturbations(2, seed=seed, angle_deg=2.0, length=0.02):
            errors.append(pose_error(refined(source, target, T_TRUE @ shift), T_TRUE))
    assert max(float(angle) for angle, _ in errors) < 1.5
    assert max(float(offset) for _, offset in errors) < 0.015


def test_stray_points_do_not_pull() -> None:
    source, target = clouds(800)
    stray = torch.from_numpy(np.random.default_rng(3).normal(size=(80, 3)))
    spoiled = Cloud(torch.cat([source.points, stray]))
    shift = perturbations(1, seed=4, angle_deg=0.5, length=0.005)[0]
    angle, offset = pose_error(refined(spoiled, target, T_TRUE @ shift), T_TRUE)
    assert float(angle.deg2rad()) < 1e-6
    assert float(offset) < 1e-6


def test_the_pose_is_rigid_and_equivariant() -> None:
    source, target = clouds(700, same=False, noise=0.01)
    start = T_TRUE @ perturbations(1, seed=5, angle_deg=1.0, length=0.01)[0]
    T = refined(source, target, start)
    R = T[:3, :3]
    torch.testing.assert_close(R @ R.mT, torch.eye(3).double(), atol=1e-12, rtol=0)
    g, h = random_motions(2, seed=6)
    moved = refined(
        Cloud(rigid.apply(g, source.points)),
        Cloud(rigid.apply(h, target.points)),
        h @ start @ rigid.invert(g),
    )
    angle, offset = pose_error(moved, h @ T @ rigid.invert(g))
    assert float(angle) < 0.02
    assert float(offset) < 3e-4


@pytest.mark.parametrize("noise", [1e-4, 1e-3, 5e-3])
def test_the_noise_is_measured(noise: float) -> None:
    source, target = clouds(3000, noise=noise)
    residuals = residuals_at(T_TRUE, source, target, cutoff=0.08)
    # Differences of two noisy points.
    assert residuals.sigma_normal == pytest.approx(noise * 2**0.5, rel=0.25)
    assert residuals.sigma_tangent == pytest.approx(noise * 2**0.5, rel=0.25)
    assert residuals.point_share > 0.5


def test_independent_samples_are_not_trusted_as_points() -> None:
    residuals = residuals_at(T_TRUE, *clouds(3000, same=False, noise=1e-3), cutoff=0.08)
    assert residuals.sigma_tangent > 3 * residuals.sigma_normal
    assert residuals.point_share < 0.05


def test_neither_are_even_samples_of_little_noise() -> None:
    """Most of their points are each other's nearest, as are those of one sampling."""
    even = [
        Cloud(cloud.points[farthest_point_sample(cloud.points, 700)])
        for cloud in clouds(6000, same=False, noise=1e-4)
    ]
    residuals = residuals_at(T_TRUE, *even, cutoff=0.15)
    partner, _ = even[1].index.nearest(rigid.apply(T_TRUE, even[0].points))
    back, _ = even[0].index.nearest(rigid.apply(rigid.invert(T_TRUE), even[1].points[partner]))
    assert float((back == torch.arange(700)).double().mean()) > 0.58
    assert residuals.trust == 0.0
    assert residuals.point_share < 1e-3


def test_the_problem_does_not_depend_on_the_target_frame() -> None:
    source, target = clouds(600, same=False, noise=0.01)
    here = residuals_at(T_TRUE, source, target, cutoff=0.1)
    h = random_motions(1, seed=7)[0]
    turned = Cloud(rigid.apply(h, target.points))
    there = residuals_at(h @ T_TRUE, source, turned, cutoff=0.1)
    np.testing.assert_allclose(there.H, here.H, rtol=1e-6, atol=1e-6 * here.H.max())
    np.testing.assert_allclose(there.g, here.g, rtol=1e-6, atol=1e-6 * here.H.max())
    assert here.reach == pytest.approx(there.reach)


def test_pairs_that_are_followed_are_those_that_are_found_anew() -> None:
    """Pose after pose, ever closer, one object against a new one each time."""
    source, target = clouds(900, same=False, missing=0.3, noise=0.01)
    followed = ClosestPairs(source, target, every=2)
    for step, shift in enumerate(perturbations(12, seed=9, angle_deg=3.0, length=0.03)):
        scale = 0.6**step
        T = T_TRUE @ rigid.exp_se3(scale * rigid.log_se3(shift))
        cutoff = 0.05 + 0.1 * scale
        found = followed.residuals(T.numpy(), cutoff=cutoff)
        anew = ClosestPairs(source, target, every=2).residuals(T.numpy(), cutoff=cutoff)
        for name, value in vars(anew).items():
            np.testing.assert_array_equal(getattr(found, name), value, err_msg=name)


def test_nothing_near_leaves_the_pose_and_no_information() -> None:
    source, target = clouds(200)
    away = rigid.make(torch.eye(3).double(), torch.tensor([50.0, 0, 0]).double())
    residuals = residuals_at(away, source, target, cutoff=0.1)
    assert not residuals.H.any()
    assert not residuals.g.any()
    torch.testing.assert_close(refine_fine(away, source, target, start=0.1), away)


@pytest.mark.parametrize("kind", ["plane", "four points", "copies"])
def test_degenerate_clouds_keep_a_finite_pose(kind: str) -> None:
    points, _ = teapot(300)
    cloud = {
        "plane": points * torch.tensor([1.0, 1.0, 0.0]),
        "four points": points[:4],
        "copies": points[:100].repeat(5, 1),
    }[kind].double()
    source, target = Cloud(cloud), Cloud(rigid.apply(T_TRUE, cloud))
    shift = perturbations(1, seed=8, angle_deg=0.2, length=0.002)[0]
    T = refined(source, target, T_TRUE @ shift)
    assert bool(torch.isfinite(T).all())
    moved, truth = (rigid.apply(pose, cloud) for pose in (T, T_TRUE))
    assert float((moved - truth).norm(dim=1).max()) < 0.01
