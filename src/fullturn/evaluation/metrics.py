"""How far a found pose is from the true one, and whether its probability can be believed.

Poses are `T_target_source` (4, 4), leading axes broadcast; lengths are in the unit of the clouds.
Errors are per pair: averaging is the caller's, over *all* pairs, failures included.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from fullturn.errors import InputError
from fullturn.geometry.motion import move, rotation_angle_deg

SUCCESS_ANGLE_DEG = 5.0
_BINS = 10  # of equal width, for calibration
_LEVEL, _RESAMPLES = 0.95, 2000  # of bootstrap intervals
SUCCESS_SHARE = 0.05  # of the source's radius


def rotation_error_deg(
    found: Float[np.ndarray, "*#batch 4 4"], true: Float[np.ndarray, "*#batch 4 4"]
) -> Float[np.ndarray, "..."] | np.floating:
    """The angle of R_trueᵀ·R_found, in [0, 180].

    >>> quarter = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    >>> float(rotation_error_deg(quarter, np.eye(4)))
    90.0
    """
    return rotation_angle_deg(np.swapaxes(true[..., :3, :3], -1, -2) @ found[..., :3, :3])


def translation_error(
    found: Float[np.ndarray, "*#batch 4 4"], true: Float[np.ndarray, "*#batch 4 4"]
) -> Float[np.ndarray, "..."] | np.floating:
    """|t − t_true|; it depends on where the source frame has its origin."""
    return np.linalg.norm(found[..., :3, 3] - true[..., :3, 3], axis=-1)


def point_distances(
    found: Float[np.ndarray, "4 4"],
    true: Float[np.ndarray, "4 4"],
    source: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, " n"]:
    """|T·x − T_true·x| of every source point."""
    difference = found - true
    return np.linalg.norm(source @ difference[:3, :3].T + difference[:3, 3], axis=1)


def mean_point_distance(
    found: Float[np.ndarray, "4 4"],
    true: Float[np.ndarray, "4 4"],
    source: Float[np.ndarray, "n 3"],
) -> float:
    """(1/N)·Σ|T·x − T_true·x|: what released code often calls RMSE."""
    return float(point_distances(found, true, source).mean())


def add(
    found: Float[np.ndarray, "4 4"],
    true: Float[np.ndarray, "4 4"],
    model: Float[np.ndarray, "n 3"],
) -> float:
    """ADD: how far the points of a model are off on average (Hinterstoisser et al., ACCV 2012)."""
    return mean_point_distance(found, true, model)


def add_s(
    found: Float[np.ndarray, "4 4"],
    true: Float[np.ndarray, "4 4"],
    model: Float[np.ndarray, "n 3"],
) -> float:
    """ADD-S: (1/N)·Σᵢ minⱼ |T_true·xᵢ − T·xⱼ|: a symmetric model may be turned onto itself.

    Never above `add`.
    """
    # In the frame of the found model, so that large offsets cost no digits.
    R_found = found[:3, :3]
    moved = model @ (R_found.T @ true[:3, :3]).T + R_found.T @ (true[:3, 3] - found[:3, 3])
    return float(cKDTree(model).query(moved)[0].mean())


def rmse(
    found: Float[np.ndarray, "4 4"],
    true: Float[np.ndarray, "4 4"],
    source: Float[np.ndarray, "n 3"],
) -> float:
    """√((1/N)·Σ|T·x − T_true·x|²)."""
    return float(np.sqrt(np.square(point_distances(found, true, source)).mean()))


def rmse_paper(
    found: Float[np.ndarray, "4 4"],
    true: Float[np.ndarray, "4 4"],
    source: Float[np.ndarray, "n 3"],
) -> float:
    """(1/N)·√(Σ|T·x − T_true·x|²): the formula as printed, `rmse`/√N."""
    return float(np.sqrt(np.square(point_distances(found, true, source)).sum()) / len(source))


def radius(points: Float[np.ndarray, "n 3"]) -> float:
    """The largest distance of a point from the mean."""
    return float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())


def pose_success(
    found: Float[np.ndarray, "4 4"],
    true: Float[np.ndarray, "4 4"],
    source: Float[np.ndarray, "n 3"],
) -> bool:
    """Within 5° and 5 % of the source's radius.

    The offset is that of the source's mean, so that the frame's origin does not matter. What
    `success_probability` speaks of is the same but for the radius, that of the larger cloud.
    """
    offset = point_distances(found, true, source.mean(axis=0, keepdims=True))[0]
    return bool(
        rotation_error_deg(found, true) < SUCCESS_ANGLE_DEG
        and offset < SUCCESS_SHARE * radius(source)
    )


def truncated_distance(
    T_target_source: Float[np.ndarray, "4 4"],
    source: Float[np.ndarray, "n 3"],
    target: Float[np.ndarray, "m 3"],
    *,
    truncation: float,
) -> float:
    """The mean of both one-sided means of min(nearest distance, truncation)."""
    moved = move(T_target_source, source)
    forth, back = (
        # Beyond the bound the tree stops looking and says infinity.
        np.minimum(cKDTree(there).query(here, distance_upper_bound=truncation)[0], truncation)
        for here, there in ((moved, target), (target, moved))
    )
    return float(0.5 * (forth.mean() + back.mean()))


def fit_distance(
    T_target_source: Float[np.ndarray, "4 4"],
    source: Float[np.ndarray, "n 3"],
    target: Float[np.ndarray, "m 3"],
) -> float:
    """How badly a pose explains two clouds: `truncated_distance` at 5 % of the source's radius."""
    truncation = SUCCESS_SHARE * radius(source)
    return truncated_distance(T_target_source, source, target, truncation=truncation)


def geometric_success(
    found: Float[np.ndarray, "4 4"],
    true: Float[np.ndarray, "4 4"],
    source: Float[np.ndarray, "n 3"],
    target: Float[np.ndarray, "m 3"],
    *,
    fit_of_true: float | None = None,
) -> bool:
    """Whether the pose explains both clouds as well as the true one, or is within 5° of it.

    As well: its `fit_distance` is at most 1.05 times that of the true pose (`fit_of_true`, where it
    is known already). So a pose that a symmetry makes equal is a success.
    """
    if rotation_error_deg(found, true) < SUCCESS_ANGLE_DEG:
        return True
    if fit_of_true is None:
        fit_of_true = fit_distance(true, source, target)
    # Exactly equal clouds have distance 0 but for rounding.
    slack = 1e-9 * radius(source)
    return fit_distance(found, source, target) <= 1.05 * fit_of_true + slack


def recall(errors: Float[np.ndarray, " n"], threshold: float) -> float:
    """The share of pairs with an error below the threshold; NaN counts as failed.

    >>> recall(np.array([0.5, 3.0, np.nan, 170.0]), 5.0)
    0.5
    """
    return float(np.mean(np.asarray(errors) < threshold))


def reliability(
    probability: Float[np.ndarray, " n"], success: Bool[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """(mean probability, share right, pairs) of each tenth of [0, 1] that holds a pair.

    >>> said, right, pairs = reliability(np.array([0.9, 0.92, 0.1]), np.array([True, False, False]))
    >>> said.round(2).tolist(), right.tolist(), pairs.tolist()
    ([0.1, 0.91], [0.0, 0.5], [1.0, 2.0])
    """
    probability, success = _checked(probability, success)
    number = np.minimum((probability * _BINS).astype(np.int64), _BINS - 1)
    pairs = np.bincount(number, minlength=_BINS)
    filled = pairs > 0
    said = np.bincount(number, weights=probability, minlength=_BINS)[filled] / pairs[filled]
    right = np.bincount(number, weights=success, minlength=_BINS)[filled] / pairs[filled]
    return said, right, pairs[filled].astype(np.float64)


def expected_calibration_error(
    probability: Float[np.ndarray, " n"], success: Bool[np.ndarray, " n"]
) -> float:
    """Σ (n_b/n)·|share of successes − mean probability|, over the bins of `reliability`.

    >>> expected_calibration_error(np.array([0.9, 0.9]), np.array([True, False]))
    0.4
    """
    said, right, pairs = reliability(probability, success)
    return float((pairs * np.abs(right - said)).sum() / pairs.sum())


def brier(probability: Float[np.ndarray, " n"], success: Bool[np.ndarray, " n"]) -> float:
    """The mean of (probability − success)²; 0 is perfect, always saying ½ gives ¼."""
    probability, success = _checked(probability, success)
    return float(np.square(probability - success).mean())


def risk_coverage(
    probability: Float[np.ndarray, " n"], success: Bool[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """(coverage, risk): the share of failures among the k most probable answers, k = 1…n."""
    probability, success = _checked(probability, success)
    order = np.argsort(-probability, kind="stable")
    answered = np.arange(1, len(order) + 1)
    return answered / len(order), np.cumsum(1.0 - success[order]) / answered


def bootstrap_interval(
    values: Float[np.ndarray, " n"] | Bool[np.ndarray, " n"],
    rng: np.random.Generator,
) -> tuple[float, float]:
    """The percentile bootstrap interval of a mean over pairs: 95 % of 2,000 draws."""
    values = np.asarray(values, dtype=np.float64)
    if len(values) == 0:
        raise InputError("expected at least one value, got none; run at least one pair")
    drawn = values[rng.integers(len(values), size=(_RESAMPLES, len(values)))].mean(axis=1)
    low, high = np.quantile(drawn, [(1.0 - _LEVEL) / 2.0, (1.0 + _LEVEL) / 2.0])
    return float(low), float(high)


def _checked(probability: np.ndarray, success: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    probability = np.asarray(probability, dtype=np.float64)
    success = np.asarray(success, dtype=np.float64)
    if probability.shape != success.shape or probability.ndim != 1 or len(probability) == 0:
        raise InputError(
            "expected two equally long lists of at least one pair, got shapes "
            f"{probability.shape} and {success.shape}; pass a probability and a success per pair"
        )
    if not ((probability >= 0.0) & (probability <= 1.0)).all():
        raise InputError(
            f"expected probabilities in [0, 1], got {probability.min()} to {probability.max()}; "
            "leave out pairs without one"
        )
    return probability, success
