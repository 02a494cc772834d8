"""A largest rotation: who is told it, who refuses it, and that no answer turns by more."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import fullturn
from fullturn.errors import InputError
from fullturn.geometry.cloud import Cloud
from fullturn.methods.base import Estimate, Method
from fullturn.methods.check import check_max_rotation, run_method
from fullturn.methods.registry import get, names
from told_method import Told

TAKERS = [name for name in names() if get(name).traits.limits_rotation]
BEYOND_DEG = 5.0  # refinement of the answer may go over the limit by so much


class Untold(Method):
    name, summary, reference = "untold", "takes clouds alone", "this test"

    def estimate(self, source: Cloud, target: Cloud, *, rng: np.random.Generator) -> Estimate:
        return Estimate(torch.eye(4, dtype=torch.float64)[None])


def ask(method: Method, limit_deg: float | None) -> None:
    cloud = Cloud(torch.rand(9, 3, dtype=torch.float64))
    run_method(method, cloud, cloud, rng=np.random.default_rng(0), max_rotation_deg=limit_deg)


@pytest.mark.parametrize(
    ("limit_deg", "limit_rad"), [(None, None), (45.0, math.pi / 4), (180.0, None)]
)
def test_only_methods_that_take_a_limit_are_told_it(
    limit_deg: float | None, limit_rad: float | None
) -> None:
    told = Told()
    ask(told, limit_deg)
    assert told.max_rotation_rad == limit_rad
    ask(Untold(), limit_deg)  # which would fail, told anything


def test_the_default_search_takes_a_limit() -> None:
    assert {"consensus", "gmcnet+consensus"} <= set(TAKERS)
    assert not {"gmcnet", "icp-point", "ransac"} & set(TAKERS)


@pytest.mark.parametrize("value", [1e-3, 45, 180, np.float32(30.0), np.int64(90)])
def test_angles_above_0_and_up_to_180_pass(value: Any) -> None:
    checked = check_max_rotation(value, Told)
    assert type(checked) is float
    assert checked == value
    with pytest.raises(InputError, match=r"\(consensus, .*\), got untold; choose"):
        check_max_rotation(value, Untold)


@pytest.mark.parametrize(
    "value", [0, 0.0, -1.0, 180.001, math.nan, math.inf, True, "45", [45.0], np.eye(2), 1j]
)
@pytest.mark.parametrize("method", [Told, Untold])
def test_others_are_refused_by_every_method(value: Any, method: type[Method]) -> None:
    with pytest.raises(InputError, match="max_rotation_deg: expected an angle above 0 and up to"):
        check_max_rotation(value, method)


def test_no_limit_is_none() -> None:
    assert check_max_rotation(None, Told) is check_max_rotation(None, Untold) is None


def lump(count: int, rng: np.random.Generator) -> np.ndarray:
    """A closed surface without symmetry, away from the origin."""
    u = rng.normal(size=(count, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    bumps = 1 + 0.3 * np.sin(3 * u[:, :1] + 1) + 0.2 * u[:, 1:2] * u[:, 2:]
    return u * bumps * (1.0, 0.8, 0.6) + (0.9, 0.3, 0.0)


def turned(points: np.ndarray, *rotvec_deg: float) -> np.ndarray:
    return points @ Rotation.from_rotvec(rotvec_deg, degrees=True).as_matrix().T + (3.0, -2.0, 1.0)


def angles_deg(result: fullturn.Registration) -> np.ndarray:
    poses = [result.T_target_source, *(other.T_target_source for other in result.alternatives)]
    R = np.array([T[:3, :3] for T in poses])
    return np.degrees(Rotation.from_matrix(R).magnitude())


@pytest.mark.parametrize("method", TAKERS)
@pytest.mark.parametrize("angle_deg", [20.0, -20.0, 160.0, -160.0])
def test_of_two_poses_half_a_turn_apart_the_small_one_is_the_answer(
    method: str, angle_deg: float
) -> None:
    half = lump(450, np.random.default_rng(0))
    source = np.concatenate([half, half * (-1.0, -1.0, 1.0)])
    target = turned(source, 0.0, 0.0, angle_deg)
    angles = angles_deg(fullturn.register(source, target, method=method, max_rotation_deg=45.0))
    assert angles[0] == pytest.approx(20.0, abs=1.0)
    assert angles.max() <= 45.0 + BEYOND_DEG


@pytest.mark.parametrize("method", TAKERS)
@pytest.mark.parametrize("limit_deg", [5.0, 60.0])
def test_no_answer_turns_by_more(method: str, limit_deg: float) -> None:
    rng = np.random.default_rng(1)
    source = lump(500, rng)
    others = {
        "turned by more": turned(lump(500, rng), 70.0, 70.0, 0.0),
        "another object": rng.normal(size=(400, 3)),
        "flat": rng.normal(size=(300, 3)) * (1.0, 1.0, 0.0),
        "four points": rng.normal(size=(4, 3)),
    }
    for kind, target in others.items():
        result = fullturn.register(source, target, method=method, max_rotation_deg=limit_deg)
        assert angles_deg(result).max() <= limit_deg + BEYOND_DEG, kind


@pytest.mark.parametrize("method", TAKERS)
def test_half_a_turn_is_no_limit(method: str) -> None:
    rng = np.random.default_rng(2)
    source, target = lump(400, rng), turned(lump(400, rng), 0.0, 100.0, 120.0)
    free = fullturn.register(source, target, method=method)
    limited = fullturn.register(source, target, method=method, max_rotation_deg=180)
    np.testing.assert_array_equal(free.T_target_source, limited.T_target_source)
