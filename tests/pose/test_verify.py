"""Every feature against its definition with SciPy, and what must not change any of them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from pose_shapes import level_of, perturbations, random_motions, teapot
from scipy.spatial import cKDTree
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.pose import verify
from fullturn.pose.contact import Surface, contacts, prepare_surface
from fullturn.pose.levels import LevelPair
from fullturn.pose.verify import MEASURED, agreement, likenesses

H = 0.05
T_TRUE = random_motions(1, seed=1)[0]
SIDED = ("distance_half", "distance_two", "plane", "smooth_half", "overlap", "conflict_middle")


def surface(
    count: int,
    seed: int,
    *,
    T: Tensor | None = None,
    eye: tuple[float, float, float] | None = None,
    noise: float = 0.0,
    reverse: bool = False,
) -> Surface:
    """A part of the teapot in the frame of T, with its true normals, in float64."""
    points, normals = teapot(count, seed)
    kept = points[:, 1] > -0.2 if seed % 2 else points[:, 1] < 0.2
    points, normals = points[kept], normals[kept]
    points = points + noise * torch.from_numpy(
        np.random.default_rng(seed).normal(size=points.shape)
    )
    viewpoint = None if eye is None else torch.tensor(eye).double()
    if T is not None:
        points, normals = rigid.apply(T, points), normals @ T[:3, :3].mT
        viewpoint = None if viewpoint is None else rigid.apply(T, viewpoint[None])[0]
    level = level_of(points, -normals if reverse else normals)
    return prepare_surface(level, spacing=H, viewpoint=viewpoint)


def measure(T: Tensor, source: Surface, target: Surface) -> Tensor:
    return verify.measure(contacts(T, source, target), spacing=H)


def one_side(T: np.ndarray, moving: Surface, fixed: Surface) -> dict[str, float]:
    """The features of one direction, from the definitions: every mean counts area."""
    R, t = T[:3, :3], T[:3, 3]
    points, smooth = moving.points.numpy() @ R.T + t, moving.smooth.numpy() @ R.T + t
    normals = moving.normals.numpy() @ R.T
    distance, partner = cKDTree(fixed.points.numpy()).query(points)
    d = distance / H
    other = fixed.normals.numpy()[partner]
    height = np.abs(((points - fixed.points.numpy()[partner]) * other).sum(1))
    smooth_height = np.abs(((smooth - fixed.smooth.numpy()[partner]) * other).sum(1)) / H
    cosine = np.abs((normals * other).sum(1))
    near = d < 1.5
    area = moving.area.numpy()

    def log(value: float) -> float:
        return math.log(value + 1e-6)

    def mean(value: np.ndarray) -> float:
        return float(np.average(value, weights=area))

    def near_mean(value: np.ndarray) -> float:
        return float(np.average(value[near], weights=area[near])) if near.any() else 0.0

    found = {
        f"distance_{name}": log(mean(np.minimum(d, cap) ** 2))
        for name, cap in (("half", 0.5), ("one", 1.0), ("two", 2.0))
    }
    found["plane"] = log(near_mean(np.minimum(height / H, 1) ** 2))
    for name, cap in (("tight", 0.15), ("half", 0.5), ("one", 1.0)):
        found[f"smooth_{name}"] = log(near_mean(np.minimum(smooth_height, cap) ** 2))
    found["normals"] = near_mean(1 - cosine)
    found["overlap"] = mean(near)
    found["overlap_tight"] = mean((d < 1) & (smooth_height < 0.2))
    found["split"] = mean(near & (smooth_height > 0.5))
    hangs = fixed.interior.numpy()[partner] & (height > 0.5 * distance) & (d > 1.5)
    edges = {"low": (0.0, 0.05), "middle": (0.05, 0.1), "high": (0.1, 0.25)}
    for name, (low, high) in edges.items():
        found[f"conflict_{name}"] = mean(hangs & (distance > low) & (distance <= high))
    rim = near & ~moving.interior.numpy()
    both = rim & ~fixed.interior.numpy()[partner]
    found["rims"] = mean(both) / mean(rim)
    return found


@pytest.mark.parametrize("which", range(4))
def test_every_feature_by_hand(which: int) -> None:
    T = T_TRUE @ perturbations(4, seed=2, angle_deg=3.0 + 8 * which, length=0.02 * which)[which]
    source, target = surface(900, 1), surface(700, 2, T=T_TRUE)
    found = dict(zip(MEASURED, measure(T[None], source, target)[0], strict=True))
    there = one_side(T.numpy(), source, target)
    back = one_side(np.linalg.inv(T.numpy()), target, source)
    for name, value in there.items():
        assert float(found[name]) == pytest.approx((value + back[name]) / 2, abs=1e-6), name
    for name in SIDED:
        expected = abs(there[name] - back[name])
        assert float(found[f"{name}_sides"]) == pytest.approx(expected, abs=1e-6)
    assert {name for name in MEASURED if name.startswith("sight")} == {
        "sight_blocked",
        "sight_empty",
        "sight_outside",
        "sight_known",
    }
    assert float(found["sight_known"]) == 0.0
    sides = [
        np.average(x.normals.numpy(), axis=0, weights=x.area.numpy()) for x in (source, target)
    ]
    lengths = [np.linalg.norm(side) for side in sides]
    cosine = sides[1] @ T[:3, :3].numpy() @ sides[0] / np.prod(lengths)
    assert float(found["same_side"]) == pytest.approx(cosine, abs=1e-6)
    assert float(found["one_sided"]) == pytest.approx(np.mean(lengths), abs=1e-6)
    assert float(found["log_points"]) == pytest.approx(
        math.log(min(len(source.points), len(target.points))), rel=1e-6
    )


def test_the_names_are_distinct_and_one_row_comes_per_pose() -> None:
    assert len(set(MEASURED)) == len(MEASURED)
    T = random_motions(7, seed=3)
    features = measure(T, surface(300, 1), surface(300, 2))
    assert features.shape == (7, len(MEASURED))
    assert bool(torch.isfinite(features).all())
    one = measure(T[4:5], surface(300, 1), surface(300, 2))[0]
    torch.testing.assert_close(features[4], one, atol=1e-9, rtol=0)


def test_swapping_the_clouds_changes_nothing() -> None:
    T = T_TRUE @ perturbations(5, seed=4, angle_deg=10.0, length=0.05)
    eyes = (2.0, 1.0, 1.0), (-2.0, -1.5, 0.5)
    source, target = surface(600, 1, eye=eyes[0]), surface(500, 2, T=T_TRUE, eye=eyes[1])
    there = measure(T, source, target)
    back = measure(rigid.invert(T), target, source)
    torch.testing.assert_close(there, back, atol=1e-6, rtol=0)


@pytest.mark.parametrize("reverse", [False, True])
def test_no_frame_changes_it_and_the_sign_of_normals_one_column(reverse: bool) -> None:
    T = T_TRUE @ perturbations(5, seed=5, angle_deg=10.0, length=0.05)
    plain = measure(T, surface(600, 1), surface(500, 2, T=T_TRUE))
    g, h = random_motions(2, seed=6)
    moved = measure(
        h @ T @ rigid.invert(g),
        surface(600, 1, T=g, reverse=reverse),
        surface(500, 2, T=h @ T_TRUE),
    )
    if reverse:  # which side of a cloud the normals lie on is all that their sign says
        plain[:, MEASURED.index("same_side")] *= -1
    torch.testing.assert_close(plain, moved, atol=1e-6, rtol=0)


def test_the_right_pose_fits_better_than_wrong_ones() -> None:
    eyes = (0.5, 3.0, 1.0), (-0.5, -3.0, 1.0)
    source = surface(1200, 1, eye=eyes[0], noise=0.005)
    target = surface(1200, 2, T=T_TRUE, eye=eyes[1], noise=0.005)
    wrong = T_TRUE @ perturbations(12, seed=7, angle_deg=60.0, length=0.1)
    rows = measure(torch.cat([T_TRUE[None], wrong]), source, target)
    column = dict(zip(MEASURED, rows.T, strict=True))
    for name in ("distance_half", "distance_two", "smooth_one", "normals", "split"):
        assert float(column[name][0]) < float(column[name][1:].min()), name
    for name in ("overlap", "overlap_tight"):
        assert float(column[name][0]) > float(column[name][1:].max()), name
    assert bool((column["sight_known"] == 1).all())


def test_the_rim_is_known() -> None:
    line = torch.arange(-1, 1.001, 0.05).double()
    sheet = torch.cartesian_prod(line, line, torch.zeros(1).double())
    up = torch.tensor([0.0, 0, 1]).double().expand(len(sheet), 3)
    found = prepare_surface(level_of(sheet, up), spacing=0.05, viewpoint=None)
    outermost = sheet.abs().amax(1)
    assert not bool(found.interior[outermost > 0.99].any())
    assert bool(found.interior[outermost < 0.9].all())


def test_smoothing_takes_noise_off_a_plane_and_leaves_its_outline() -> None:
    rng = np.random.default_rng(8)
    points = torch.from_numpy(rng.uniform(-1, 1, (1500, 3)))
    points[:, 2] = torch.from_numpy(rng.normal(0, 0.01, 1500))
    up = torch.tensor([0.0, 0, 1]).double().expand(1500, 3)
    found = prepare_surface(level_of(points, up), spacing=H, viewpoint=None)
    assert float(found.smooth[:, 2].std()) < 0.45 * float(points[:, 2].std())
    torch.testing.assert_close(found.smooth[:, :2], points[:, :2])


def test_poses_far_apart_are_finite_and_have_no_overlap() -> None:
    away = torch.eye(4).double()[None].clone()
    away[0, 0, 3] = 20.0
    source, target = surface(200, 1, eye=(2, 1, 1)), surface(200, 2, eye=(2, 1, 1))
    row = measure(away, source, target)[0]
    assert bool(torch.isfinite(row).all())
    assert float(row[MEASURED.index("overlap")]) == 0.0


@pytest.mark.parametrize("count", [3, 5])
def test_a_handful_of_points(count: int) -> None:
    points, normals = teapot(count)
    level = level_of(points, normals)
    few = prepare_surface(level, spacing=H, viewpoint=None)
    assert bool(torch.isfinite(few.smooth).all())
    assert bool(torch.isfinite(measure(random_motions(2), few, few)).all())


def test_agreement_of_descriptors_by_hand() -> None:
    line = torch.linspace(-1, 1, 21).unsqueeze(1) * torch.tensor([1.0, 0.0, 0.0])
    level = level_of(line, torch.tensor([0.0, 0.0, 1.0]).expand(21, 3))
    level = replace(level, area=torch.ones(21))
    pair = LevelPair(level, level, 0.1)
    alike = torch.eye(21) * 0.9
    poses = torch.eye(4).repeat(3, 1, 1)
    poses[1, 0, 3] = 0.1  # one step along: each meets its neighbor
    poses[2, 1, 3] = 5.0  # nothing meets
    found = agreement(likenesses(poses, pair, alike), spacing=pair.spacing)
    torch.testing.assert_close(
        found, torch.tensor([[0.9, 0.0], [0.0, 0.9], [0.0, 0.0]]), atol=0.05, rtol=0
    )
