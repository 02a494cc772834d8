from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fullturn.errors import InputError
from fullturn.evaluation import metrics


def motion(angle_deg: float = 0.0, axis: tuple = (0, 0, 1), shift: tuple = (0, 0, 0)) -> np.ndarray:
    T = np.eye(4)
    unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    T[:3, :3] = Rotation.from_rotvec(np.deg2rad(angle_deg) * unit).as_matrix()
    T[:3, 3] = shift
    return T


@pytest.mark.parametrize("angle_deg", [0.0, 1e-7, 1e-3, 45.0, 90.0, 179.0, 179.99999, 180.0])
def test_rotation_error_is_the_angle(angle_deg: float) -> None:
    base = motion(77.0, (1, 2, 3), (4, 5, 6))
    found = base @ motion(angle_deg, (-1, 0.3, 2))
    assert metrics.rotation_error_deg(found, base) == pytest.approx(angle_deg, abs=1e-6)
    assert metrics.rotation_error_deg(base, found) == pytest.approx(angle_deg, abs=1e-6)


def test_small_angles_keep_their_digits() -> None:
    # arccos((tr − 1)/2) would say 0 here.
    assert metrics.rotation_error_deg(motion(1e-7), np.eye(4)) == pytest.approx(1e-7, rel=1e-6)


def test_errors_broadcast_over_leading_axes() -> None:
    found = np.stack([motion(10.0, shift=(3, 4, 0)), motion(20.0)])
    assert np.allclose(metrics.rotation_error_deg(found, np.eye(4)), [10.0, 20.0])
    assert np.allclose(metrics.translation_error(found, np.eye(4)), [5.0, 0.0])


def test_three_point_distances_counted_by_hand() -> None:
    # A half turn about z moves (1,0,0) by 2, (0,2,0) by 4, the origin by 0, (0,0,5) by 0.
    source = np.array([[1.0, 0, 0], [0, 2, 0], [0, 0, 0], [0, 0, 5]])
    found, true = motion(180.0), np.eye(4)
    assert np.allclose(metrics.point_distances(found, true, source), [2, 4, 0, 0])
    assert metrics.mean_point_distance(found, true, source) == pytest.approx(1.5)
    assert metrics.rmse(found, true, source) == pytest.approx(np.sqrt(5.0))
    assert metrics.rmse_paper(found, true, source) == pytest.approx(np.sqrt(20.0) / 4)


def test_pose_success_needs_angle_and_offset_wherever_the_origin_is() -> None:
    source = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    assert metrics.radius(source) == pytest.approx(1.0)
    assert metrics.pose_success(motion(4.9, shift=(0.049, 0, 0)), np.eye(4), source)
    assert not metrics.pose_success(motion(5.1), np.eye(4), source)
    assert not metrics.pose_success(motion(0.0, shift=(0.051, 0, 0)), np.eye(4), source)
    # Far from the origin the lever moves t, yet the clouds lie as they did.
    away = source + np.array([1e6, 0, 0])
    shift = (1e6, 0, 0)
    about_center = motion(shift=shift) @ motion(4.0) @ motion(shift=(-1e6, 0, 0))
    assert metrics.pose_success(about_center, np.eye(4), away)
    assert metrics.translation_error(about_center, np.eye(4)) > 1e4


def test_truncated_distance_counted_by_hand() -> None:
    source = np.array([[0.0, 0, 0], [10, 0, 0]])
    target = np.array([[0.0, 0.3, 0], [0, 0, 50], [11, 0, 0]])
    # Forth: 0.3 and 1 → 0.65; back: 0.3, 2 (cut), 1 → 1.1.
    value = metrics.truncated_distance(np.eye(4), source, target, truncation=2.0)
    assert value == pytest.approx(0.5 * (0.65 + 1.1))


def test_geometric_success_accepts_symmetric_poses_only() -> None:
    rng = np.random.default_rng(0)
    quarter = rng.uniform(-1, 1, (300, 3)) * (1.0, 0.4, 0.05)
    source = np.concatenate([quarter, quarter * (-1, -1, 1)])  # two-fold about z
    target = source + rng.normal(0, 0.005, source.shape)
    assert metrics.geometric_success(motion(180.0), np.eye(4), source, target)
    assert metrics.geometric_success(motion(4.9), np.eye(4), source, target)
    assert not metrics.geometric_success(motion(90.0), np.eye(4), source, target)
    assert not metrics.geometric_success(motion(180.0, (1, 1, 0)), np.eye(4), source, target)
    # Equal clouds, exact symmetry: both distances are rounding errors.
    assert metrics.geometric_success(motion(180.0), np.eye(4), source, source)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_geometric_success_knows_no_unit(scale: float) -> None:
    rng = np.random.default_rng(1)
    source = rng.normal(size=(200, 3)) * scale
    target = source + rng.normal(0, 0.01 * scale, source.shape)
    assert not metrics.geometric_success(motion(90.0), np.eye(4), source, target)


def test_recall_counts_failures() -> None:
    errors = np.array([0.0, 4.999, 5.0, np.nan, np.inf])
    assert metrics.recall(errors, 5.0) == pytest.approx(0.4)


def test_calibration_counted_by_hand() -> None:
    probability = np.array([0.95, 0.91, 1.0, 0.25, 0.21])
    success = np.array([True, True, False, False, True])
    # Bin [0.9, 1]: mean 0.9533, right 2/3; bin [0.2, 0.3): mean 0.23, right 1/2.
    expected = (3 * abs(2.86 / 3 - 2 / 3) + 2 * abs(0.23 - 0.5)) / 5
    assert metrics.expected_calibration_error(probability, success) == pytest.approx(expected)
    squares = 0.05**2 + 0.09**2 + 1.0 + 0.25**2 + 0.79**2
    assert metrics.brier(probability, success) == pytest.approx(squares / 5)


def test_calibrated_probabilities_have_a_small_error() -> None:
    rng = np.random.default_rng(0)
    probability = rng.random(50_000)
    success = rng.random(50_000) < probability
    assert metrics.expected_calibration_error(probability, success) < 0.02
    assert metrics.brier(probability, success) == pytest.approx(1 / 6, abs=0.01)


def test_risk_coverage_counted_by_hand() -> None:
    probability = np.array([0.2, 0.9, 0.5, 0.7])
    success = np.array([False, True, True, False])
    coverage, risk = metrics.risk_coverage(probability, success)
    assert np.allclose(coverage, [0.25, 0.5, 0.75, 1.0])
    assert np.allclose(risk, [0.0, 1 / 2, 1 / 3, 1 / 2])


@pytest.mark.usefixtures("unchecked")
def test_bad_probabilities_are_named() -> None:
    with pytest.raises(InputError, match=r"in \[0, 1\]"):
        metrics.brier(np.array([1.2]), np.array([True]))
    with pytest.raises(InputError, match=r"of at least one pair, got shapes \(0,\) and \(0,\)"):
        metrics.brier(np.zeros(0), np.zeros(0, dtype=bool))
    with pytest.raises(InputError, match="equally long"):
        metrics.risk_coverage(np.array([0.2]), np.array([True, False]))


def test_bootstrap_interval_matches_the_normal_one() -> None:
    values = np.random.default_rng(0).normal(3.0, 2.0, 400)
    low, high = metrics.bootstrap_interval(values, np.random.default_rng(1))
    half = 1.96 * values.std() / 20
    assert low == pytest.approx(values.mean() - half, abs=0.03)
    assert high == pytest.approx(values.mean() + half, abs=0.03)
    assert (low, high) == metrics.bootstrap_interval(values, np.random.default_rng(1))
    with pytest.raises(InputError, match="at least one value"):
        metrics.bootstrap_interval(np.array([]), np.random.default_rng(0))
