"""What measurements of one relative pose say together.

Every edge between two scans, or two groups of scans, is a measurement of their relative pose: a few
poses with probabilities p, and a doubt d that none is right. Against a relative pose T it speaks
with f(T) = Σ p/ε over its poses that agree with T, plus d, where ε is the chance that a wrong pose
agrees; against "none of these" with f = d, or less where others of a symmetric shape's turns would
be as right. With T's own prior ε, one edge alone gives back its probabilities, those of poses that
agree together, and edges that agree raise each other's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fullturn.geometry.motion import invert, nearest_rotation, rigid

# The most probable ones; the work grows with their number squared.
_MOST_HYPOTHESES = 64


@dataclass(frozen=True)
class AgreementConfig:
    """When two poses agree, and how much that says."""

    tolerance_deg: float = 12.0  # two poses agree within this angle
    tolerance: float = 0.12  # … and this shift, in units of the fusion
    chance: float = 0.1  # ε; far above a random pose's, for wrong poses of alike scans agree too
    least_doubt: float = 0.02  # of any edge, however sure it is


@dataclass(frozen=True, eq=False)
class Measurement:
    """What one edge, or one path of two, says of a relative pose."""

    T_one_other: np.ndarray  # (k, 4, 4)
    probability: np.ndarray  # (k,)
    doubt: float  # that none of the poses is right
    none: float  # … nor any other turn of a symmetric shape


@dataclass(frozen=True, eq=False)
class Posterior:
    """Distinct relative poses, the most probable first."""

    T_one_other: np.ndarray  # (h, 4, 4)
    probability: np.ndarray  # (h,)
    none: float  # the probability that none of them is right
    shares: np.ndarray  # (h, m): the probability that each measurement gives each of them


def posterior(
    measurements: Sequence[Measurement],
    at: np.ndarray,
    config: AgreementConfig,
    is_turn: np.ndarray | None = None,
) -> Posterior:
    """What measurements, of which some pose must have a probability above 0, say together.

    Poses agree within the tolerances, the shift taken at the point `at` (3,), and where `is_turn`,
    between all poses in the order of the measurements (n, n), says so. Each one that is returned is
    the mean of those that agree with it within the tolerances.
    """
    T = np.concatenate([m.T_one_other for m in measurements])
    p = np.concatenate([m.probability for m in measurements])
    starts = np.cumsum([0, *(len(m.T_one_other) for m in measurements[:-1])])
    doubt, none = (
        np.maximum([getattr(m, name) for m in measurements], config.least_doubt)
        for name in ("doubt", "none")
    )
    order = np.argsort(-p, kind="stable")[:_MOST_HYPOTHESES]
    order = order[p[order] > 0]
    near = agree(T[order], T, at, config)
    same = near if is_turn is None else near | is_turn[order]

    def said(of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shares = np.add.reduceat(of * p, starts, axis=1)
        return shares, np.log(shares / config.chance + doubt).sum(1) + np.log(config.chance)

    shares, weight = said(same)
    alone = weight if is_turn is None else said(near)[1]
    kept: list[int] = []
    for number in np.lexsort((-alone, -weight)):
        if not same[number, order[kept]].any():
            kept.append(int(number))
    log = np.array([*weight[kept], np.log(none).sum()])
    probability = np.exp(log - log.max())
    probability /= probability.sum()
    means = np.stack([_mean(T, near[number] * p, at) for number in kept])
    return Posterior(means, probability[:-1], float(probability[-1]), shares[kept])


def _mean(T: np.ndarray, weight: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The weighted mean of poses (m, 4, 4) that are nearly the same, its shift taken at `at`."""
    share = weight / weight.sum()
    R = nearest_rotation(np.tensordot(share, T[:, :3, :3], 1))
    return rigid(R, share @ (T[:, :3, :3] @ at + T[:, :3, 3]) - R @ at)


def agree(
    one: np.ndarray, other: np.ndarray, at: np.ndarray, config: AgreementConfig
) -> np.ndarray:
    """Which poses (m, 4, 4) and (n, 4, 4) are the same within the tolerances: bool (m, n)."""
    trace = np.einsum("mij,nij->mn", one[:, :3, :3], other[:, :3, :3])
    close = trace > 1.0 + 2.0 * np.cos(np.deg2rad(config.tolerance_deg))
    places = [T[:, :3, :3] @ at + T[:, :3, 3] for T in (one, other)]
    shift = np.linalg.norm(places[0][:, None] - places[1][None], axis=-1)
    result: np.ndarray = close & (shift < config.tolerance)
    return result


def agree_here(
    T_target_source: np.ndarray, T_target: np.ndarray, T_source: np.ndarray, config: AgreementConfig
) -> np.ndarray:
    """Which relative poses (k, 4, 4) of two scans agree with where both stand: bool (k,)."""
    now = invert(T_target) @ T_source
    result: np.ndarray = agree(now[None], T_target_source, np.zeros(3), config)[0]
    return result
