"""The default method end to end: right, honest about symmetry and strangers, robust, repeatable."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import fullturn
from fullturn.data.motion import uniform_rotation
from fullturn.data.procedural import demo_object, procedural_mesh
from fullturn.data.surface import sample_surface
from fullturn.geometry.motion import move, rigid
from fullturn.pose.verdict import Judged


@cache
def teapot() -> trimesh.Trimesh:
    return demo_object()


def partial(mesh: trimesh.Trimesh, count: int, *, seed: int, side: float = 0.0) -> np.ndarray:
    """Random points of the surface; `side` ±1 leaves out a fifth at that end of the y axis."""
    points = sample_surface(mesh, count, np.random.default_rng(seed))
    height = side * points[:, 1]
    return points[height <= np.quantile(height, 0.8)] if side else points


def true_pose(seed: int, *, length: float = 1.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rigid(uniform_rotation(rng), rng.normal(size=3) * length)


def angle_deg(T: np.ndarray, T_true: np.ndarray) -> float:
    R = T_true[:3, :3].T @ T[:3, :3]
    return float(np.degrees(Rotation.from_matrix(R).magnitude()))


def shift(T: np.ndarray, T_true: np.ndarray, points: np.ndarray) -> float:
    """How far apart the two poses put the middle of the cloud, in radii."""
    middle = points.mean(0, keepdims=True)
    radius = np.linalg.norm(points - middle, axis=1).max()
    return float(np.linalg.norm(move(T, middle) - move(T_true, middle)) / radius)


def assert_right(
    result: fullturn.Registration, T_true: np.ndarray, points: np.ndarray, *, within_deg: float = 3
) -> None:
    T = result.T_target_source
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    assert angle_deg(T, T_true) < within_deg
    assert shift(T, T_true, points) < 0.05


@pytest.mark.parametrize(
    ("unit", "offset"), [(1.0, 0.0), (1e-3, 0.0), (1e3, 0.0), (1.0, 1e6), (1e3, 1e6)]
)
def test_partial_clouds_in_every_unit(unit: float, offset: float) -> None:
    T_true = true_pose(1)
    T_true[:3, 3] *= unit
    source = partial(teapot(), 1500, seed=1, side=1) * unit
    target = move(T_true, partial(teapot(), 1300, seed=2, side=-1) * unit)
    # The same motion between frames whose origins are far away.
    far = np.array([offset, -offset, offset / 2])
    T_far = T_true.copy()
    T_far[:3, 3] += far - T_true[:3, :3] @ far
    result = fullturn.register(source + far, target + far)
    assert_right(result, T_far, source + far)
    assert result.success_probability > 0.3
    assert min(result.overlap) > 0.6


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_the_same_points_are_found_exactly(seed: int) -> None:
    points = partial(teapot(), 1000, seed=seed)
    T_true = true_pose(seed)
    rng = np.random.default_rng(seed)
    source = rng.permutation(points[points[:, 1] > -0.2])
    target = move(T_true, rng.permutation(points[points[:, 1] < 0.3]))
    result = fullturn.register(source, target)
    np.testing.assert_allclose(result.T_target_source, T_true, atol=1e-6)
    assert result.success_probability > 0.9


@pytest.fixture(scope="module")
def twofold() -> tuple[fullturn.Registration, np.ndarray, np.ndarray, np.ndarray]:
    """Two samples of two teapots, half a turn about z apart; the result, the clouds, the truth."""
    half_turn = np.eye(4)
    half_turn[:2, :2] *= -1
    moved = teapot().copy()
    moved.apply_translation((0.55, 0.25, 0.0))
    pair = trimesh.util.concatenate([moved, moved.copy().apply_transform(half_turn)])
    T_true = true_pose(5)
    source = sample_surface(pair, 2500, np.random.default_rng(1))
    target = move(T_true, sample_surface(pair, 2500, np.random.default_rng(2)))
    return fullturn.register(source, target), source, T_true, T_true @ half_turn


def test_a_half_turn_gives_one_half_each(
    twofold: tuple[fullturn.Registration, np.ndarray, np.ndarray, np.ndarray],
) -> None:
    result, source, *truths = twofold
    poses = [result.T_target_source, *(a.T_target_source for a in result.alternatives)]
    shares = [result.success_probability, *(a.success_probability for a in result.alternatives)]
    # The two samplings tip the scales a little; neither pose may be sure, or be ruled out.
    assert 0.1 < shares[1] <= shares[0] < 0.9
    assert 0.8 < sum(shares) <= 1.0 + 1e-9
    for T_true in truths:
        assert min(angle_deg(T, T_true) for T in poses[:2]) < 5.0
    assert min(shift(poses[0], T_true, source) for T_true in truths) < 0.05
    assert shares == sorted(shares, reverse=True)


def test_the_half_turn_is_named(
    twofold: tuple[fullturn.Registration, np.ndarray, np.ndarray, np.ndarray],
) -> None:
    symmetry = twofold[0].symmetry
    assert symmetry is not None
    assert symmetry.order == 2
    np.testing.assert_allclose(symmetry.axis, [0, 0, 1], atol=0.1)
    assert "2-fold" in symmetry.description


def test_an_object_without_symmetry_has_none() -> None:
    T_true = rigid(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    source = partial(teapot(), 1500, seed=1)
    result = fullturn.register(source, move(T_true, partial(teapot(), 1500, seed=2)))
    assert result.symmetry is None
    assert_right(result, T_true, source)


def test_strangers_get_little_probability() -> None:
    totals = []
    for seed in range(8):
        one, other = (procedural_mesh(np.random.default_rng([seed, kind])) for kind in (1, 2))
        result = fullturn.register(
            partial(one, 1000, seed=seed), partial(other, 1000, seed=seed + 1, side=1)
        )
        shares = [a.success_probability for a in result.alternatives]
        totals.append(result.success_probability + sum(shares))
    assert max(totals) <= 0.2


@pytest.mark.parametrize("count", [4, 8, 20, 50])
def test_tiny_strangers_get_little_probability(count: int) -> None:
    answers = []
    for seed in range(8):
        rng = np.random.default_rng([count, seed])
        source, target = rng.normal(size=(2, count, 3))
        answers.append(fullturn.register(source, target).success_probability)
    assert float(np.mean(answers)) <= 0.2


@pytest.mark.parametrize("method", ["auto", "icp-point"])
def test_a_handful_of_points_gets_little_probability_and_a_reason(method: str) -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 2]], float)
    result = fullturn.register(points, points, method=method)
    shares = [a.success_probability for a in result.alternatives]
    assert result.success_probability + sum(shares) <= 0.2 + 1e-9
    assert any(note.startswith("fewer than 12 points: ") for note in result.notes)


UNEVEN = pytest.mark.xfail(reason="a third, far worse pose among the finalists moves one by 0.2")


@pytest.mark.parametrize(
    ("seed", "noise"),
    [pytest.param(8, 0.0, marks=UNEVEN), (8, 1e-4), (9, 0.0), (10, 0.0), (11, 0.0), (12, 0.0)],
)
def test_an_exact_symmetry_gives_one_half_each(seed: int, noise: float) -> None:
    half = move(rigid(np.eye(3), np.array([1.0, 0.0, 0.0])), partial(teapot(), 500, seed=seed))
    points = np.concatenate([half, half * [-1.0, -1.0, 1.0]])
    rng = np.random.default_rng(seed)
    target = rng.permutation(move(true_pose(seed), points)) + noise * rng.normal(size=points.shape)
    result = fullturn.register(points, target)
    assert result.symmetry is not None
    assert result.symmetry.order == 2
    assert result.success_probability == pytest.approx(0.5, abs=0.1)
    assert result.alternatives[0].success_probability == pytest.approx(0.5, abs=0.1)


def test_fifty_points() -> None:
    T_true = true_pose(6)
    points = partial(teapot(), 50, seed=6)
    target = move(T_true, np.random.default_rng(6).permutation(points))
    result = fullturn.register(points, target)
    np.testing.assert_allclose(result.T_target_source, T_true, atol=1e-6)
    # Fifty points of another draw leave much open; the answer is sound, the confidence moderate.
    other = fullturn.register(points, move(T_true, partial(teapot(), 50, seed=7)))
    assert np.isfinite(other.T_target_source).all()
    assert 0.0 <= other.success_probability <= 1.0


def test_a_hundred_thousand_points() -> None:
    T_true = true_pose(7)
    source = partial(teapot(), 100_000, seed=7, side=1)
    target = move(T_true, partial(teapot(), 100_000, seed=8, side=-1))
    result = fullturn.register(source, target)
    assert_right(result, T_true, source, within_deg=0.5)
    assert result.success_probability > 0.4


@pytest.mark.parametrize(("n", "m"), [(1500, 60_000), (60_000, 1500)])
def test_very_different_densities(n: int, m: int) -> None:
    T_true = true_pose(8)
    source = partial(teapot(), n, seed=8, side=1)
    target = move(T_true, partial(teapot(), m, seed=9, side=-1))
    result = fullturn.register(source, target)
    # A teapot is nearly the same turned around: the sparse cloud may not decide it, but then the
    # answer must not be sure, and the truth must be on the list.
    poses = [result.T_target_source, *(a.T_target_source for a in result.alternatives)]
    errors = [angle_deg(T, T_true) for T in poses]
    assert min(errors) < 3
    assert errors[0] < 3 or result.success_probability < 0.5


def test_density_that_varies_over_the_surface() -> None:
    T_true = true_pose(9)
    rng = np.random.default_rng(9)
    source, target = (partial(teapot(), 6000, seed=seed) for seed in (9, 10))
    # Each cloud is half as dense on one side as on the other.
    source = source[rng.random(6000) < np.where(source[:, 0] > 0, 0.5, 0.25)]
    target = move(T_true, target[rng.random(6000) < np.where(target[:, 0] < 0, 0.5, 0.25)])
    assert_right(fullturn.register(source, target), T_true, source)


def test_copies_of_points() -> None:
    T_true = true_pose(10)
    source = np.repeat(partial(teapot(), 1000, seed=10), 3, axis=0)
    target = partial(teapot(), 1000, seed=11)
    target = move(T_true, np.concatenate([target, np.repeat(target[:1], 700, axis=0)]))
    assert_right(fullturn.register(source, target), T_true, source)


@pytest.mark.parametrize("distance", [5.0, 15.0, 1e6, 1e12, 1e100])
def test_a_few_stray_points(distance: float) -> None:
    T_true = true_pose(11)
    stray = np.random.default_rng(11).normal(size=(3, 3)) * distance
    points = partial(teapot(), 1200, seed=11)
    target = move(T_true, partial(teapot(), 1200, seed=12))
    result = fullturn.register(np.concatenate([points, stray]), target)
    assert_right(result, T_true, points)
    assert result.success_probability > 0.5
    assert any("stray" in note for note in result.notes) == (distance > 10)


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_another_unit_by_mistake_is_answered_with_no_confidence(factor: float) -> None:
    source, target = (partial(teapot(), 3000, seed=seed) for seed in (12, 13))
    result = fullturn.register(source, target * factor)
    assert result.success_probability < 0.3
    assert any("unit" in note for note in result.notes)
    assert any("how probable a pose is isn't known" in note for note in result.notes)


def test_a_sensor_inside_a_room_agrees_with_what_it_saw() -> None:
    source_eye, target_eye = np.array([2.0, 1.2, 1.4]), np.array([2.3, 1.4, 1.2])
    T_true = true_pose(13)
    source = room(3000, seed=1)
    target = move(T_true, room(3000, seed=2))
    result = fullturn.register(
        source,
        target,
        source_viewpoint=source_eye,
        target_viewpoint=move(T_true, target_eye[None])[0],
    )
    assert_right(result, T_true, source)
    assert result.success_probability > 0.5


def room(count: int, *, seed: int) -> np.ndarray:
    """Walls, floor and ceiling with a cupboard and a bench."""
    parts = [((0, 0, 0), (4, 3, 2.5)), ((0.5, 0.5, 0), (1.5, 1, 0.8)), ((3, 2, 0), (4, 2.6, 1.8))]
    meshes = [trimesh.creation.box(bounds=np.array(part, dtype=float)) for part in parts]
    return sample_surface(trimesh.util.concatenate(meshes), count, np.random.default_rng(seed))


def contents(result: fullturn.Registration) -> list[Any]:
    arrays = (result.T_target_source, result.matches, result.match_weights, result.covariance)
    others = [(a.T_target_source.tobytes(), a.success_probability) for a in result.alternatives]
    return [*(a.tobytes() for a in arrays), result.success_probability, result.overlap, others]


def test_the_same_input_gives_the_same_bytes() -> None:
    source = partial(teapot(), 1500, seed=14, side=1)
    target = partial(teapot(), 1500, seed=15, side=-1)
    first, second = (fullturn.register(source, target) for _ in range(2))
    assert contents(first) == contents(second)


def test_stages_are_timed() -> None:
    cloud = partial(teapot(), 500, seed=16)
    seconds = fullturn.register(cloud, cloud).seconds
    assert {
        "levels",
        "describe",
        "match",
        "hypothesize",
        "refine",
        "verify",
        "verdict",
        "fine",
    } <= (set(seconds))


def bumpy(count: int, seed: int) -> np.ndarray:
    """Points of a blob with bumps all over, which fits onto itself in one way only."""
    d = np.random.default_rng(seed).normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    x, y = d[:, :1], d[:, 1:2]
    nose = np.exp(-8.0 * np.square(d - [0.5, 0.6, 0.62]).sum(1, keepdims=True))
    return d * (1.0 + 0.3 * np.sin(3 * x + 1) * np.cos(2 * y) + 0.4 * nose) * [1.0, 1.2, 0.8]


@pytest.mark.parametrize("copies", [2, 8, 20])
def test_copies_of_every_point_change_nothing(copies: int) -> None:
    source, target, T_true = bumpy(1000, 0), bumpy(1000, 1), true_pose(7)
    source, target = source[source[:, 0] > -0.3], move(T_true, target[target[:, 1] > -0.5])
    once = fullturn.register(source, target)
    assert once.success_probability > 0.9
    assert angle_deg(once.T_target_source, T_true) < 0.5
    found = fullturn.register(np.repeat(source, copies, axis=0), target)
    assert found.success_probability > 0.9
    np.testing.assert_allclose(found.T_target_source, once.T_target_source, atol=1e-6)
    np.testing.assert_allclose(found.covariance, once.covariance, rtol=0.03, atol=1e-8)
    assert found.success_probability == pytest.approx(once.success_probability, abs=0.01)
    assert found.overlap == pytest.approx(once.overlap, abs=0.01)


def test_a_sensor_may_stand_anywhere() -> None:
    rng = np.random.default_rng(0)
    source, target = (sample_surface(demo_object(), 300, rng) for _ in range(2))
    said = {
        fullturn.register(source, target, source_viewpoint=(0, 0, far)).success_probability
        for far in (1e8, 1e40, 1e200)
    }
    assert max(said) - min(said) < 1e-6


def test_a_refined_answer_takes_the_pose_that_it_came_to(monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    from fullturn.methods import consensus

    source, target = (partial(teapot(), 300, seed=seed) for seed in (1, 2))
    judged = consensus.find_and_judge

    def two_near(*clouds: Any, **options: Any) -> Any:
        """The answer, with one half, and a pose 8° away with a quarter."""
        found, _ = judged(*clouds, **options)
        T = torch.eye(4).double().repeat(2, 1, 1)
        T[1, :3, :3] = torch.from_numpy(Rotation.from_rotvec([0, 0, np.radians(8)]).as_matrix())
        two = dataclasses.replace(
            found, T_target_source=T, features=found.features[[0, 0]], signals=None
        )
        return two, Judged([0, 1], [0.5, 0.25], 0.0)

    monkeypatch.setattr(consensus, "find_and_judge", two_near)
    monkeypatch.setattr(consensus, "refine_fine", lambda T, *_, **__: T)
    apart = fullturn.register(source, target)
    assert apart.success_probability == pytest.approx(0.5)
    assert len(apart.alternatives) == 1

    def turned(T: Any, *_: Any, **__: Any) -> Any:
        turn = Rotation.from_rotvec([0, 0, np.radians(6)]).as_matrix()
        return T @ torch.from_numpy(rigid(turn, np.zeros(3)))

    monkeypatch.setattr(consensus, "refine_fine", turned)
    together = fullturn.register(source, target)
    assert together.success_probability == pytest.approx(0.75)
    assert together.alternatives == ()
