"""What measurements of one relative pose say together.

Every edge between two scans, or two groups of scans, is a measurement of their relative pose: a few
poses with probabilities p, and a doubt d that none is right. Against a relative pose T it speaks
with f(T) = Σ p/ε over its poses that agree with T, plus d, where ε is the chance that a wrong pose
agrees; against "none of these" with f = d. With T's own prior ε, one edge alone gives back its
probabilities, those of poses that agree together, and edges that agree raise each other's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fullturn.geometry.motion import nearest_rotation, rigid

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
    doubt: float


def posterior(
    measurements: Sequence[Measurement], at: np.ndarray, config: AgreementConfig
) -> tuple[np.ndarray, np.ndarray, float]:
    """Distinct relative poses (h, 4, 4) with their probabilities (h,), best first, and none's.

    Some pose must have a probability above 0.

    Poses agree within the tolerances, the shift taken at the point `at` (3,); each one that is
    returned is the mean of those that agree with it.
    """
    T = np.concatenate([m.T_one_other for m in measurements])
    p = np.concatenate([m.probability for m in measurements])
    starts = np.cumsum([0, *(len(m.T_one_other) for m in measurements[:-1])])
    doubt = np.log([max(m.doubt, config.least_doubt) for m in measurements])
    order = np.argsort(-p, kind="stable")[:_MOST_HYPOTHESES]
    hypotheses = T[order[p[order] > 0]]
    agreeing = agree(hypotheses, T, at, config) * p / config.chance
    spoken = np.add.reduceat(agreeing, starts, axis=1) + np.exp(doubt)
    weight = np.log(spoken).sum(1) + np.log(config.chance)
    same = agree(hypotheses, hypotheses, at, config)
    kept: list[int] = []
    for number in np.argsort(-weight, kind="stable"):
        if not same[number, kept].any():
            kept.append(int(number))
    log = np.array([*weight[kept], doubt.sum()])
    share = np.exp(log - log.max())
    share /= share.sum()
    means = np.stack([_mean(T, agreeing[number], at) for number in kept])
    return means, share[:-1], float(share[-1])


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
