"""The method contract: eleven clauses that every registered method keeps, or declares it can't.

A clause that a method's traits name is expected to fail: the test asserts that it does, so a
trait that is no longer true is found.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from contract_methods import METHODS, SLOW
from contract_shapes import bracket, motion, move, pose_error, ring

from fullturn import Registration, register, register_many
from fullturn.errors import InputError
from fullturn.methods.registry import get

# What "the same pose" means: success as `success_probability` defines it.
ANGLE_DEG, SHIFT = 5.0, 0.05


@pytest.fixture(scope="module")
def pair() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two clouds of one shape, each with points of its own, a small motion apart; the truth."""
    rng = np.random.default_rng(7)
    T_true = motion(rng, max_angle_deg=15.0)
    shape = bracket(500, seed=1)
    source, target = shape[:450], move(T_true, shape[50:])
    return source, rng.permutation(target), T_true


def same_pose(T: np.ndarray, T_other: np.ndarray, points: np.ndarray) -> bool:
    angle_deg, shift = pose_error(T, T_other, points)
    return angle_deg < ANGLE_DEG and shift < 2 * SHIFT


def expect(clause: Callable[[], bool], *, fails: bool) -> None:
    """The clause holds; or, with the trait that names it, it does not."""
    assert clause() is not fails


@pytest.mark.parametrize("method", [*METHODS, *SLOW])
def test_0_the_pair_is_solved(method: str, pair: tuple[np.ndarray, ...]) -> None:
    source, target, T_true = pair
    T = register(source, target, method=method).T_target_source
    expect(lambda: same_pose(T, T_true, source), fails=get(method).traits.whole)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("other", ["partner", "unrelated", "plane", "four points"])
def test_1_the_answer_is_rigid(method: str, other: str, pair: tuple[np.ndarray, ...]) -> None:
    source = pair[0]
    target = {
        "partner": pair[1],
        "unrelated": ring(400),
        "plane": bracket(200) * (1, 1, 0),
        "four points": np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]]),
    }[other]
    assert_sound(register(source, target, method=method), source, target)


@pytest.mark.parametrize("method", METHODS)
def test_2_a_cloud_lies_on_itself(method: str, pair: tuple[np.ndarray, ...]) -> None:
    source = pair[0]
    result = register(source, source, method=method)
    angle_deg, shift = pose_error(result.T_target_source, np.eye(4), source)
    assert angle_deg < 0.5
    assert shift < 0.01


@pytest.mark.parametrize("method", METHODS)
def test_3_moving_the_clouds_moves_the_pose(method: str, pair: tuple[np.ndarray, ...]) -> None:
    source, target, _ = pair
    T = register(source, target, method=method).T_target_source

    def clause() -> bool:
        kept = []
        for seed in range(3):
            rng = np.random.default_rng(seed)
            g, h = motion(rng), motion(rng)
            moved = register(move(g, source), move(h, target), method=method).T_target_source
            kept.append(same_pose(moved, h @ T @ np.linalg.inv(g), move(g, source)))
        return all(kept)

    expect(clause, fails=get(method).traits.local)


@pytest.mark.parametrize("method", METHODS)
def test_4_the_order_of_points_is_nothing(method: str, pair: tuple[np.ndarray, ...]) -> None:
    source, target, _ = pair
    rng = np.random.default_rng(3)
    T = register(source, target, method=method).T_target_source
    shuffled = register(rng.permutation(source), rng.permutation(target), method=method)
    assert same_pose(shuffled.T_target_source, T, source)


@pytest.mark.parametrize("method", METHODS)
def test_5_swapping_the_clouds_inverts(method: str, pair: tuple[np.ndarray, ...]) -> None:
    source, target, _ = pair
    T = register(source, target, method=method).T_target_source
    back = register(target, source, method=method).T_target_source
    assert same_pose(back, np.linalg.inv(T), target)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("scale", "offset"), [(1e-3, 0.0), (1e3, 0.0), (37.0, 1e6)])
def test_6_the_unit_is_nothing(
    method: str, scale: float, offset: float, pair: tuple[np.ndarray, ...]
) -> None:
    source, target, _ = pair
    T = register(source, target, method=method).T_target_source.copy()
    far = np.array([offset, -offset, offset])
    scaled = register(source * scale + far, target * scale + far, method=method).T_target_source
    T[:3, 3] = T[:3, 3] * scale + far - T[:3, :3] @ far
    assert same_pose(scaled, T, source * scale + far)
    np.testing.assert_allclose(scaled[:3, :3], T[:3, :3], atol=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_7_a_batch_equals_the_loop(method: str, pair: tuple[np.ndarray, ...]) -> None:
    source, target, _ = pair
    pairs = [(source, target), (source[:2], target), (target, source), (source[::2], target)]
    loop = [register(*pairs[i], method=method) for i in (0, 2, 3)]
    for workers in (1, 2):
        batch = register_many(pairs, method=method, workers=workers)
        assert isinstance(batch.pop(1), InputError)
        for one, many in zip(loop, batch, strict=True):
            assert isinstance(many, Registration)
            assert fingerprint(one) == fingerprint(many)


@pytest.mark.parametrize("method", METHODS)
def test_8_every_kind_of_cloud_and_none_is_modified(
    method: str, pair: tuple[np.ndarray, ...]
) -> None:
    source, target, _ = pair
    T = register(source, target, method=method).T_target_source
    kinds: list[Callable[[np.ndarray], Any]] = [
        lambda x: x,
        lambda x: x.tolist(),
        lambda x: torch.from_numpy(x.copy()),
        lambda x: torch.from_numpy(x).float(),
        lambda x: SimpleNamespace(points=x),
        lambda x: SimpleNamespace(vertices=x),
    ]
    before = source.tobytes(), target.tobytes()
    for kind in kinds:
        result = register(kind(source), kind(target), method=method)
        assert same_pose(result.T_target_source, T, source)
    assert (source.tobytes(), target.tobytes()) == before
    frozen = source.copy(), target.copy()
    for points in frozen:
        points.flags.writeable = False
    register(*frozen, method=method)


@pytest.mark.parametrize("method", [*METHODS, *SLOW])
def test_9_the_same_seed_gives_the_same_bytes(method: str, pair: tuple[np.ndarray, ...]) -> None:
    source, target, _ = pair
    first, second = (register(source, target, method=method, seed=5) for _ in range(2))
    assert fingerprint(first) == fingerprint(second)
    threads = torch.get_num_threads()
    torch.set_num_threads(threads + 1)
    try:
        third = register(source, target, method=method, seed=5)
        assert torch.get_num_threads() == threads + 1
    finally:
        torch.set_num_threads(threads)
    assert fingerprint(first) == fingerprint(third)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (np.zeros((0, 3)), "at least 3 points, it is empty"),
        ([[0, 0, np.nan], [1, 0, 0], [0, 1, 0]], "finite points, 1 of 3"),
        ([[0, 0, np.inf], [1, 0, 0], [0, 1, 0]], "finite points, 1 of 3"),
        ([[1, 2, 3]] * 9, "3 distinct points, found 1"),
        ([[1, 2, 3], [4, 5, 6]] * 9, "3 distinct points, found 2"),
        (np.zeros((9, 2)), r"shape \(N, 3\).*found \(9, 2\)"),
        (np.zeros((3, 9)), r"shape \(N, 3\).*found \(3, 9\); transpose"),
        (np.zeros((2, 9, 3)), r"shape \(N, 3\).*batch \(2, 9, 3\)"),
        (np.arange(30.0)[:, None] * [[1, 2, 3]], "all 30 lie on one line"),
    ],
)
def test_10_bad_input_is_named(
    method: str, bad: Any, message: str, pair: tuple[np.ndarray, ...]
) -> None:
    good = pair[0]
    for role, clouds in (("source", (bad, good)), ("target", (good, bad))):
        with pytest.raises(InputError, match=f"^{role}: expected .*{message}"):
            register(*clouds, method=method)


@pytest.mark.parametrize("method", METHODS)
def test_11_unrelated_shapes_get_little_confidence(method: str) -> None:
    result = register(bracket(500), ring(500), method=method)
    total = result.success_probability + sum(a.success_probability for a in result.alternatives)
    assert total < 0.5


def assert_sound(result: Registration, source: np.ndarray, target: np.ndarray) -> None:
    """Everything that holds for every result, right or wrong."""
    poses = [result.T_target_source, *(a.T_target_source for a in result.alternatives)]
    for T in poses:
        assert T.shape == (4, 4)
        assert T.dtype == np.float64
        assert np.isfinite(T).all()
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-6)
        np.testing.assert_allclose(np.linalg.det(T[:3, :3]), 1.0, atol=1e-6)
        np.testing.assert_array_equal(T[3], [0, 0, 0, 1])
    shares = [result.success_probability, *(a.success_probability for a in result.alternatives)]
    assert all(0.0 <= share <= 1.0 for share in shares)
    assert sum(shares) <= 1.0 + 1e-9
    assert len(result.overlap) == 2
    assert all(0.0 <= share <= 1.0 for share in result.overlap)
    assert result.matches.dtype == np.int64
    assert result.matches.shape == (len(result.match_weights), 2)
    if len(result.matches):
        assert result.matches.min() >= 0
        assert (result.matches.max(axis=0) < (len(source), len(target))).all()
        assert result.match_weights.min() >= 0.0
        assert result.match_weights.max() <= 1.0
    assert result.covariance.shape == (6, 6)
    assert np.isfinite(result.covariance).all()
    np.testing.assert_array_equal(result.covariance, result.covariance.T)
    assert np.linalg.eigvalsh(result.covariance).min() >= -1e-9 * np.abs(result.covariance).max()
    assert result.seconds["total"] > 0.0


def fingerprint(result: Registration) -> tuple[Any, ...]:
    """All of a result but its timings, as bytes."""
    arrays = (result.T_target_source, result.matches, result.match_weights, result.covariance)
    return (
        *(a.tobytes() for a in arrays),
        result.success_probability,
        result.overlap,
        result.method,
        result.notes,
        [(a.T_target_source.tobytes(), a.success_probability) for a in result.alternatives],
        None if result.symmetry is None else result.symmetry.description,
    )
