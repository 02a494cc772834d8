"""Which finalist is right, and how probably; or none of them."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, fields
from functools import cache

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.errors import FullturnError
from fullturn.geometry import rigid
from fullturn.geometry.cloud import Cloud
from fullturn.geometry.extent import center_and_radius
from fullturn.nn.packaged import packaged_weights
from fullturn.pose.confidence import trusted
from fullturn.pose.verify import FEATURES, FINE

# What "the same pose" and "right" mean: within 5° and 5 % of the larger cloud's radius, at the
# source's mean.
TOLERANCE_RAD = math.radians(5.0)
TOLERANCE_OFFSET = 0.05
# What the fit has seen, and what all poses together get beyond that.
_LEAST_POINTS = 12
_LEAST_SIZE = 0.1  # of the smaller cloud's radius in that of the larger one
_UNKNOWN = 0.2
_STEPS = (0.03, 0.1, 0.3)
_SMALL_TURN = 0.1  # of the limit
_SERIES_BELOW_RAD = 1e-3
_TIE = 1e-3  # weight of what only decides between equals
_LARGEST_INPUT = 6.0  # standard deviations; beyond it, nothing was seen in the fit


@dataclass(frozen=True, eq=False)
class VerdictWeights:
    """One hidden layer over a finalist's features, and a score for "none of them"."""

    mean: Float[Tensor, " f"]
    deviation: Float[Tensor, " f"]
    hidden: Float[Tensor, "f h"]
    hidden_bias: Float[Tensor, " h"]
    output: Float[Tensor, " h"]
    none: Float[Tensor, ""]

    def to(self, device: torch.device) -> VerdictWeights:
        """The weights on a device."""
        return VerdictWeights(*(getattr(self, name).to(device) for name in _WEIGHTS))


_WEIGHTS = tuple(field.name for field in fields(VerdictWeights))


@dataclass(frozen=True, eq=False)
class Judged:
    """Distinct poses, the most probable first."""

    index: list[int]  # into the finalists
    probability: list[float]  # of each; they sum to at most 1
    doubt: float  # the probability that none of them is right, by their scores alone


def limited(
    probability: Float[Tensor, " k"], source: Cloud, target: Cloud
) -> tuple[Float[Tensor, " k"], tuple[str, ...]]:
    """Probabilities of poses of two normalized clouds, as far as they can be known, and a note.

    The verdict was fit on clouds of at least 12 points, and of about one size. Beyond that, all
    poses together get 0.2 at most.
    """
    small, large = sorted(
        center_and_radius(cloud.points.numpy(force=True))[1] for cloud in (source, target)
    )
    if _is_few(source) or _is_few(target):
        why = f"fewer than {_LEAST_POINTS} points"
    elif small < _LEAST_SIZE * large:
        why = f"one cloud is {large / small:.3g} times as large as the other"
    else:
        return probability, ()
    note = f"{why}: how probable a pose is isn't known, and {_UNKNOWN} at most"
    return probability * (_UNKNOWN / max(float(probability.sum()), _UNKNOWN)), (note,)


def _is_few(cloud: Cloud) -> bool:
    """Whether there are too few different points; the first hundred nearly always tell."""
    points = cloud.distinct  # a few copies may be left, all of them first
    return all(len(some.unique(dim=0)) < _LEAST_POINTS for some in (points[:100], points))


def verdict_inputs(
    features: Float[Tensor, "*batch k f"],
    present: Bool[Tensor, "*batch k"] | None = None,
    *,
    fine: int = 0,
) -> Float[Tensor, "*batch k g"]:
    """Each finalist's features, and how far each lies from the rivals' lowest and highest value.

    Of the first `fine` features, which are logarithms, these differences are also given cut off at
    3, 10 and 30 %: among all others, small ones between poses that fit about equally well are lost.
    """
    lowest = highest = features
    if present is not None:
        absent = ~present.unsqueeze(-1)
        lowest = features.masked_fill(absent, math.inf)
        highest = features.masked_fill(absent, -math.inf)
    from_lowest = features - lowest.amin(-2, keepdim=True)
    from_highest = features - highest.amax(-2, keepdim=True)
    cut = [from_lowest[..., :fine].clamp_max(step) for step in _STEPS]
    cut += [from_highest[..., :fine].clamp_min(-step) for step in _STEPS]
    return torch.cat([features, from_lowest, from_highest, *cut], -1)


def log_probabilities(
    inputs: Float[Tensor, "*batch k g"],
    weights: VerdictWeights,
    present: Bool[Tensor, "*batch k"] | None = None,
) -> Float[Tensor, "*batch k+1"]:
    """Conditional logit (McFadden 1974) over the finalists and, last, "none of them"."""
    weights = weights.to(inputs.device)
    standard = standardized(inputs, weights.mean, weights.deviation)
    score = torch.tanh(standard @ weights.hidden + weights.hidden_bias) @ weights.output
    return log_shares(score, weights.none, present)


def standardized(
    inputs: Float[Tensor, "*batch g"], mean: Float[Tensor, " g"], deviation: Float[Tensor, " g"]
) -> Float[Tensor, "*batch g"]:
    """In standard deviations, no more than were seen in the fit.

    What could not be measured (NaN) says nothing: it stands at its mean.
    """
    limited = ((inputs - mean) / deviation).clamp(-_LARGEST_INPUT, _LARGEST_INPUT)
    return limited.nan_to_num(0.0)


def log_shares(
    score: Float[Tensor, "*batch k"],
    none: Float[Tensor, ""],
    present: Bool[Tensor, "*batch k"] | None = None,
) -> Float[Tensor, "*batch k+1"]:
    """Log softmax of the finalists' scores and, last, that of "none of them"."""
    if present is not None:
        score = score.masked_fill(~present, -1e9)
    return torch.log_softmax(torch.cat([score, none.expand(*score.shape[:-1], 1)], -1), -1)


def same_pose(
    T_target_source: Float[Tensor, "k 4 4"], other: Float[Tensor, "m 4 4"]
) -> Bool[Tensor, "k m"]:
    """Which poses lie within the tolerance of which others (normalized lengths)."""
    turn = T_target_source[:, None, :3, :3].mT @ other[None, :, :3, :3]
    offset = T_target_source[:, None, :3, 3] - other[None, :, :3, 3]
    return (rigid.rotation_angle_rad(turn) < TOLERANCE_RAD) & (
        offset.norm(dim=-1) < TOLERANCE_OFFSET
    )


def log_rotation_prior(
    T_target_source: Float[Tensor, "k 4 4"], max_rotation_rad: float
) -> Float[Tensor, " k"]:
    """What a known limit L of the rotation says of a pose that turns by θ.

    Of the truth, every angle up to L is expected alike. A wrong pose turns by any rotation within
    L, which are more the larger they are: its angle has the density (1 − cos θ)/(L − sin L).
    This is the logarithm of the ratio. Angles below L/10 count as that; those beyond L, which only
    errors of a pose can lead to, count as L.
    """
    L = max_rotation_rad
    angle = rigid.rotation_angle_rad(T_target_source[:, :3, :3]).clamp(_SMALL_TURN * L, L)
    # Both to their digits for small angles: 1 − cos θ = 2 sin²(θ/2), L − sin L ≈ L³/6.
    wrong = math.log(L - math.sin(L)) if L > _SERIES_BELOW_RAD else 3 * math.log(L) - math.log(6)
    return wrong - math.log(2 * L) - 2 * (angle / 2).sin().log()


def finalist_probabilities(
    T_target_source: Float[Tensor, "k 4 4"],
    features: Float[Tensor, "k f"],
    *,
    max_rotation_rad: float | None = None,
) -> Float[Tensor, " k+1"]:
    """Of each finalist to be the right one and, last, of none; they sum to 1.

    `max_rotation_rad`: the largest rotation that is possible, where somebody knows one.
    """
    same = same_pose(T_target_source, T_target_source)
    return _shares(T_target_source, features, same, max_rotation_rad)[0]


def judge(
    T_target_source: Float[Tensor, "k 4 4"],
    features: Float[Tensor, "k f"],
    *,
    max_rotation_rad: float | None = None,
) -> Judged:
    """Rank the finalists by the probability that the truth lies within the tolerance of each.

    That probability is the sum over the finalists within the tolerance (`merge_same`).
    """
    same = same_pose(T_target_source, T_target_source)
    shares, doubt = _shares(T_target_source, features, same, max_rotation_rad)
    return Judged(*merge_same(shares[:-1], same), doubt)


def _shares(
    T_target_source: Float[Tensor, "k 4 4"],
    features: Float[Tensor, "k f"],
    same: Bool[Tensor, "k k"],
    max_rotation_rad: float | None,
) -> tuple[Float[Tensor, " k+1"], float]:
    """Of each finalist and, last, of none; and that last one as the scores alone have it."""
    log_p = log_probabilities(verdict_inputs(features.double(), fine=FINE), load_weights())
    stated = torch.stack([trusted(T_target_source, features, same, log_p), log_p])
    if max_rotation_rad is not None:
        stated[:, :-1] += log_rotation_prior(T_target_source.to(log_p), max_rotation_rad)
    shares, alone = stated.softmax(-1)
    return shares, float(alone[-1])


def merge_same(
    probability: Float[Tensor, " k"],
    same: Bool[Tensor, "k k"],
    *,
    before: Float[Tensor, " k"] | None = None,
) -> tuple[list[int], list[float]]:
    """Rows in the order of the sums of probability over what is the same, and these sums.

    Taken greedily: once a row is listed, those that it speaks for are not listed again, nor counted
    for another. Where `before` differs, it decides the order.
    """
    free = torch.ones(len(same), dtype=torch.bool, device=same.device)
    index, total = [], []
    while bool(free.any()):
        merged = (same & free).to(probability.dtype) @ probability
        rank = merged if before is None else before + _TIE * merged
        best = int(torch.where(free, rank, -1.0).argmax())
        index.append(best)
        total.append(float(merged[best]))
        free &= ~same[best]
        free[best] = False
    return index, total


@cache
@torch.inference_mode(False)
def load_weights(
    file: str = "verdict.safetensors", features: tuple[str, ...] = FEATURES
) -> VerdictWeights:
    """Weights in the package, checked against the features that this code measures.

    Raises:
        FullturnError: weights that were fit to other features.
    """
    from safetensors import safe_open

    name = file.removesuffix(".safetensors")
    with safe_open(packaged_weights(file), framework="pt") as stored:
        names = json.loads(stored.metadata()["features"])
        if names != list(features):
            raise FullturnError(
                f"{file}: expected weights fit to the {len(features)} features that are measured "
                f"of a pose, got {len(names)} others; run benchmarks/fit_{name}.py"
            )
        return VerdictWeights(**{key: stored.get_tensor(key) for key in _WEIGHTS})
