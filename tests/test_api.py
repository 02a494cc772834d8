"""The front door: units, frames, viewpoints, notes and options."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import fullturn
from fullturn import api
from fullturn.errors import InputError, ReadError
from fullturn.geometry.cloud import Cloud
from fullturn.io import save_cloud
from fullturn.methods.base import Estimate, Method, Traits
from fullturn.methods.registry import DEFAULT, get, methods, names
from told_method import Told


def shape(count: int, rng: np.random.Generator) -> np.ndarray:
    u = rng.normal(size=(count, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return u * (1 + 0.3 * np.sin(3 * u[:, :1] + 1) + 0.2 * u[:, 1:2] * u[:, 2:]) * (1.0, 0.8, 0.6)


CLOUD = shape(400, np.random.default_rng(0))
R_TRUE = Rotation.from_rotvec([0.1, -0.2, 0.15]).as_matrix()


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_the_pose_is_in_the_units_and_frames_of_the_input(unit: float, offset: float) -> None:
    source = (CLOUD + offset) * unit
    target = (CLOUD @ R_TRUE.T - 2 * offset) * unit
    result = fullturn.register(source, target, method="icp-point")
    T = result.T_target_source
    np.testing.assert_allclose(T[:3, :3], R_TRUE, atol=1e-6)
    np.testing.assert_allclose(
        source @ T[:3, :3].T + T[:3, 3], target, atol=1e-6 * unit * max(1.0, offset * 1e-3)
    )
    assert result.method == "icp-point"
    assert set(result.seconds) >= {"check", "normalize", "explain", "total"}
    assert (
        result.seconds["total"] >= sum(v for k, v in result.seconds.items() if k != "total") - 1e-3
    )


class Recorder(Method):
    """Keeps what it was given, and answers with two poses and a symmetry."""

    name = "recorder"
    summary = "for tests"
    reference = "none"
    seen: tuple[Cloud, Cloud, np.random.Generator]

    def estimate(self, source: Cloud, target: Cloud, *, rng: np.random.Generator) -> Estimate:
        Recorder.seen = source, target, rng
        T = torch.eye(4, dtype=torch.float64).repeat(2, 1, 1)
        T[1, :2, :2] *= -1.0
        symmetry: Any = SimpleNamespace(
            axis=torch.tensor([0.0, -0.0, 1.0]).double(), center=torch.zeros(3), order=2
        )
        return Estimate(T, torch.tensor([0.6, 0.3]).double(), symmetry)


@pytest.fixture
def recorder(monkeypatch: pytest.MonkeyPatch) -> type[Recorder]:
    monkeypatch.setattr(api, "make_method", lambda _: Recorder())
    return Recorder


def test_a_method_sees_centered_clouds_of_one_length(recorder: type[Recorder]) -> None:
    source, target = CLOUD * 5 + 100, CLOUD * 5 - 30
    fullturn.register(
        source, target, source_viewpoint=[110, 100, 100], target_viewpoint=(-30, -30, 20)
    )
    seen_source, seen_target, _ = recorder.seen
    for cloud in (seen_source, seen_target):
        assert cloud.points.dtype == torch.float64
        assert float(cloud.points.mean(0).abs().max()) < 1e-12
        assert 0.9 < float(cloud.points.norm(dim=1).max()) < 1.5
    length = float(np.linalg.norm(source - source.mean(0), axis=1)[0]) / float(
        seen_source.points[0].norm()
    )
    assert seen_source.viewpoint is not None
    assert seen_target.viewpoint is not None
    np.testing.assert_allclose(
        seen_source.viewpoint.numpy() * length + source.mean(0), [110, 100, 100], atol=1e-9
    )
    np.testing.assert_allclose(
        seen_target.viewpoint.numpy() * length + target.mean(0), [-30, -30, 20], atol=1e-9
    )
    fullturn.register(source, target)
    assert recorder.seen[0].viewpoint is None


def test_the_seed_reaches_the_method(recorder: type[Recorder]) -> None:
    draws = []
    for seed in (0, 0, np.int64(4)):
        fullturn.register(CLOUD, CLOUD, seed=seed)  # type: ignore[arg-type]
        draws.append(recorder.seen[2].random())
    assert draws[0] == draws[1] != draws[2]
    assert draws[2] == np.random.default_rng(4).random()


def test_the_largest_rotation_reaches_the_method(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[Any] = []

    class Limited(Recorder):
        traits = Traits(limits_rotation=True)

        def estimate(
            self,
            source: Cloud,
            target: Cloud,
            *,
            rng: np.random.Generator,
            max_rotation_rad: float | None = None,
        ) -> Estimate:
            told.append(max_rotation_rad)
            return super().estimate(source, target, rng=rng)

    monkeypatch.setattr(api, "make_method", lambda _: Limited())
    for limit_deg in (None, 90, 180.0):
        fullturn.register(CLOUD, CLOUD, max_rotation_deg=limit_deg)
    assert told == [None, pytest.approx(np.pi / 2), None]  # 180° is no limit
    for none_deg in (0, 5e-324):  # in radians, both are 0
        told = f"expected an angle above 0 and up to 180, or None, got {none_deg}"
        with pytest.raises(InputError, match=told):
            fullturn.register(CLOUD, CLOUD, max_rotation_deg=none_deg)


def test_a_method_that_takes_no_largest_rotation_says_which_do() -> None:
    told = r"expected a method that takes one \(consensus, .*\), got icp-point; choose"
    with pytest.raises(InputError, match=told):
        fullturn.register(CLOUD, CLOUD, method="icp-point", max_rotation_deg=45)


def test_a_method_that_states_no_probability_gets_the_verdict() -> None:
    target = CLOUD @ R_TRUE.T
    right = fullturn.register(CLOUD, target, method="icp-point")
    assert right.success_probability > 0.8
    assert {"judge", "explain"} <= set(right.seconds)
    other = np.random.default_rng(1).normal(size=(400, 3))
    assert fullturn.register(CLOUD, other, method="icp-point").success_probability < 0.2


def test_the_verdict_hears_of_a_largest_rotation(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bar fits turned by half, too, which a limit rules out."""
    monkeypatch.setattr(api, "make_method", lambda _: Told())
    gains = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        bar, again = rng.uniform(-1, 1, (2, 400, 3)) * [1.0, 0.3, 0.1]
        free = fullturn.register(bar, again)
        limited = fullturn.register(bar, again, max_rotation_deg=30)
        gains.append(limited.success_probability - free.success_probability)
    assert min(gains) > 0.0
    assert np.mean(gains) > 0.1


def test_the_verdict_leaves_the_methods_own_order(monkeypatch: pytest.MonkeyPatch) -> None:
    class Reversed(Recorder):
        def estimate(self, source: Cloud, target: Cloud, *, rng: np.random.Generator) -> Estimate:
            found = super().estimate(source, target, rng=rng)
            return Estimate(found.T_target_source.flip(0))

    monkeypatch.setattr(api, "make_method", lambda _: Reversed())
    result = fullturn.register(CLOUD, CLOUD)
    (better,) = result.alternatives
    np.testing.assert_allclose(better.T_target_source, np.eye(4), atol=1e-12)
    assert result.success_probability < 0.1 < 0.8 < better.success_probability
    assert result.success_probability + better.success_probability <= 1.0


def test_an_answer_that_is_none_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    class Skewed(Recorder):
        def estimate(self, source: Cloud, target: Cloud, *, rng: np.random.Generator) -> Estimate:
            return Estimate(2.0 * torch.eye(4)[None])

    monkeypatch.setattr(api, "make_method", lambda _: Skewed())
    with pytest.raises(InputError, match=r"^method recorder: expected rigid poses"):
        fullturn.register(CLOUD, CLOUD)


def test_alternatives_and_symmetry_come_through(recorder: type[Recorder]) -> None:
    result = fullturn.register(CLOUD + 3, CLOUD)
    assert result.success_probability == pytest.approx(0.6)
    (other,) = result.alternatives
    assert other.success_probability == pytest.approx(0.3)
    center = CLOUD.mean(0)
    half_turn = np.diag([-1.0, -1.0, 1.0])
    np.testing.assert_allclose(other.T_target_source[:3, :3], half_turn)
    np.testing.assert_allclose(
        other.T_target_source[:3, 3], center - half_turn @ (center + 3), atol=1e-12
    )
    assert all(0 <= share <= 1 for share in other.overlap)
    assert result.symmetry is not None
    assert result.symmetry.description == "2-fold rotation about (0.00, 0.00, 1.00)"
    assert result.symmetry.order == 2


def test_files_notes_and_dropped_points(tmp_path: Path) -> None:
    holed = np.vstack([[[np.nan] * 3], CLOUD])
    save_cloud(tmp_path / "source.ply", holed)
    save_cloud(tmp_path / "target.xyz", CLOUD)
    result = fullturn.register(
        str(tmp_path / "source.ply"), tmp_path / "target.xyz", method="icp-point"
    )
    assert any("dropped 1 of 401 points" in note for note in result.notes)
    np.testing.assert_allclose(result.T_target_source, np.eye(4), atol=1e-6)
    assert result.matches.max() < 400
    with pytest.raises(ReadError, match="there is none"):
        fullturn.register(tmp_path / "missing.ply", CLOUD, method="icp-point")
    with pytest.raises(InputError, match=r"^source: expected finite points"):
        fullturn.register(holed, CLOUD, method="icp-point")


def test_a_difference_in_units_is_noted() -> None:
    result = fullturn.register(CLOUD, CLOUD * 1000, method="icp-point")
    assert "is the unit the same?" in result.notes[0]


def test_the_registry_lists_names_and_refuses_others() -> None:
    assert names()[0] == DEFAULT
    assert {"icp-point", "icp-plane", "gicp", "ransac", "fgr", "kiss"} <= set(names())
    assert get("icp") is get("icp-plane")
    with pytest.raises(InputError, match=r"expected auto, icp, consensus, .*got 'gipc'"):
        get("gipc")


def test_methods_describes_each_in_one_line() -> None:
    assert [m.name for m in methods()] == list(names())
    for method in methods():
        assert get(method.name).name == method.name
        assert method.summary
        assert "\n" not in method.summary + method.reference
    assert get("auto") is get(DEFAULT)
