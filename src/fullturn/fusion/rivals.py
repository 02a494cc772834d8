"""Other assemblies of the same scans: which one fits best what every sensor must have seen.

On shapes that are nearly symmetric many pairs agree on the same wrong turn, so that no rule of the
graph alone finds it. What all scans saw together does: a sensor sees no surface behind another, and
none where it saw nothing. Rivals of an assembly are those in which some of its scans are moved by a
turn that the edges' other poses suggest. An assembly A scores

    score(A) = a Σ log f(edge) − b Σ regret(scan),

with f as in the graph. The regret of a scan is the least share of points, over all places where its
sensor may have stood, that contradict the place, less what that share is without the other scans.
The probability of A among its rivals is their softmax. a and b were fit to which assemblies of 40
meshes were right (conditional logit, l2 penalty 0.3 on inputs of unit variance).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from fullturn.fusion.edges import Edge
from fullturn.fusion.graph import GraphConfig
from fullturn.fusion.posterior import agree, agree_here
from fullturn.fusion.scans import CELL, Scan, thinned
from fullturn.fusion.sight import Sights
from fullturn.fusion.turns import Surface
from fullturn.geometry.motion import invert, move
from fullturn.geometry.sampling import point_spacing

_EVERY = 5  # of what is kept of a scan, one point in five is looked for in the others' images
_OF_EDGES, _OF_REGRET = 0.23, 2.7  # a and b
_TURNS, _LEAST_TURN = 4, 0.3  # tried, and the sum of probabilities that speaks for each
_SEEN = 0.1  # less regret with which the sensors speak for another assembly
_SAME = 0.01  # of its size: how near a surface lies to itself, turned, where that is a symmetry


@dataclass(frozen=True, eq=False)
class Rivals:
    """Distinct assemblies of the scans of one group, the present one first."""

    turns: Float[np.ndarray, "m 4 4"]  # in the group's frame
    is_half: Bool[np.ndarray, " m"]  # twice such a turn is none
    turn: Int[np.ndarray, " b"]  # which one moves
    moved: Bool[np.ndarray, "b n"]  # which scans; none in the first
    evidence: Float[np.ndarray, " b"]  # Σ log f
    regret: Float[np.ndarray, " b"]

    def probability(self) -> Float[np.ndarray, " b"]:
        """Of each assembly."""
        score = _score(self.evidence, self.regret)
        share = np.exp(score - score.max())
        result: np.ndarray = share / share.sum()
        return result


@dataclass(frozen=True, eq=False)
class Judgment:
    """A group as it should stand, and how surely its scans belong together so."""

    T_group_scan: Float[np.ndarray, "n 4 4"]
    is_moved: bool
    together: Float[np.ndarray, "n n"]  # probability that two scans stand to one another so


class Eyes:
    """The scans of a group as their sensors see them, by their places among all scans."""

    def __init__(self, scans: Sequence[Scan], group: Sequence[int], length: float) -> None:
        self.points = {number: thinned(scans[number], length) for number in group}
        spacing = max(
            (
                point_spacing(torch.from_numpy(points))
                for points in self.points.values()
                if len(points) > 1
            ),
            default=CELL,
        )
        self.sights = {
            number: Sights(
                torch.from_numpy(points).float(),
                spacing=spacing,
                viewpoint=None
                if scans[number].viewpoint is None
                else torch.from_numpy((scans[number].viewpoint - scans[number].center) / length),
            )
            for number, points in self.points.items()
        }


def judge_group(
    eyes: Eyes,
    group: Sequence[int],
    T_group_scan: Float[np.ndarray, "n 4 4"],
    edges: Sequence[Edge],
    config: GraphConfig,
) -> Judgment | None:
    """The assembly of a group that fits best; None where it has no rivals.

    The present one gives way to what is more probable if the sensors speak for that, too. What only
    the edges speak for has been heard before: of the two, it needs `min_probability`.
    """
    found = find_rivals(eyes, group, T_group_scan, edges, config)
    if found is None:
        return None
    probability = found.probability()
    is_seen = (probability > probability[0]) & (found.regret <= found.regret[0] - _SEEN)
    is_sure = probability >= config.min_probability * (probability + probability[0])
    best = int(np.where(is_seen | is_sure, probability, 0.0).argmax())
    poses = T_group_scan.copy()
    poses[found.moved[best]] = found.turns[found.turn[best]] @ poses[found.moved[best]]
    surface = Surface(
        np.concatenate([move(T, eyes.points[scan]) for scan, T in zip(group, poses, strict=True)])
    )
    # A turn of the shape onto itself leaves right what it moves.
    is_same = np.array([surface.stays(turn, within=_SAME) for turn in found.turns])
    moved = found.moved & ~is_same[found.turn][:, None]
    # What moves its scans from the best: its turn (1), the best's undone (−1), or both (2).
    parts = moved.astype(int) - moved[best]
    is_alike = found.turn == found.turn[best]
    parts[found.is_half[found.turn] & is_alike] **= 2
    parts[~is_alike[:, None] & moved & moved[best]] = 2
    together = (parts[:, :, None] == parts[:, None]) * probability[:, None, None]
    return Judgment(poses, best > 0, together.sum(0))


def find_rivals(
    eyes: Eyes,
    group: Sequence[int],
    T_group_scan: np.ndarray,
    edges: Sequence[Edge],
    config: GraphConfig,
) -> Rivals | None:
    """All that some turn of some scans makes of an assembly, grown from every scan, greedily."""
    place = {scan: number for number, scan in enumerate(group)}
    inner = [
        edge
        for edge in edges
        if len(edge.probability) and edge.held is None and {edge.target, edge.source} <= {*place}
    ]
    turns = _turns(inner, place, T_group_scan, config)
    if not len(turns):
        return None
    is_half = agree(turns, invert(turns), T_group_scan[:, :3, 3].mean(0), config).diagonal()
    turn, moved, evidence, regret = [], [], [], []
    for number, motion in enumerate(turns):
        said = _evidence(inner, place, T_group_scan, motion, config)
        contra = _contradictions(eyes, group, T_group_scan, motion)
        hidden = [eyes.sights[scan].hidden.numpy() for scan in group]
        labels = _grown(said, contra, hidden, is_half_turn=bool(is_half[number]))
        values = _values(labels, said, contra, hidden)
        start = 1 if number else 0  # the present assembly once
        turn += [number] * len(labels[start:])
        moved.append(labels[start:])
        evidence.append(values[0][start:])
        regret.append(values[1][start:])
    return Rivals(
        turns,
        is_half,
        np.array(turn),
        np.concatenate(moved),
        np.concatenate(evidence),
        np.concatenate(regret),
    )


def _turns(
    edges: Sequence[Edge], place: dict[int, int], T_group_scan: np.ndarray, config: GraphConfig
) -> np.ndarray:
    """Distinct motions (m, 4, 4) in the group's frame by which edges would move their source."""
    motions, shares = [np.zeros((0, 4, 4))], [np.zeros(0)]
    for edge in edges:
        T_i, T_j = (T_group_scan[place[scan]] for scan in (edge.target, edge.source))
        other = ~agree_here(edge.T_target_source, T_i, T_j, config)
        motions.append(T_i @ edge.T_target_source[other] @ invert(T_j))
        shares.append(edge.probability[other])
    motion, share = np.concatenate(motions), np.concatenate(shares)
    middle = T_group_scan[:, :3, 3].mean(0)
    same = agree(motion, motion, middle, config) | agree(motion, invert(motion), middle, config)
    kept: list[int] = []
    free = np.ones(len(motion), bool)
    while free.any() and len(kept) < _TURNS:
        speaks = np.where(free, (same & free) @ share, -1.0)
        best = int(speaks.argmax())
        if speaks[best] < _LEAST_TURN:
            break
        kept.append(best)
        free &= ~same[best]
    return motion[kept]


def _evidence(
    edges: Sequence[Edge],
    place: dict[int, int],
    T_group_scan: np.ndarray,
    motion: np.ndarray,
    config: GraphConfig,
) -> Float[np.ndarray, "n n 3"]:
    """Σ log f of the edges of two scans: as they are, the second one moved, the first one moved."""
    count = len(T_group_scan)
    result = np.zeros((count, count, 3))
    for edge in edges:
        i, j = place[edge.target], place[edge.source]
        states = _relative(T_group_scan[i], T_group_scan[j], motion)
        agreeing = agree(states, edge.T_target_source, np.zeros(3), config)
        doubt = max(edge.doubt, config.least_doubt)
        said = np.log(agreeing @ edge.probability / config.chance + doubt)
        result[i, j] += said
        result[j, i] += said[[0, 2, 1]]
    return result


def _contradictions(
    eyes: Eyes, group: Sequence[int], T_group_scan: np.ndarray, motion: np.ndarray
) -> list[Float[np.ndarray, "n 3 v"]]:
    """The shares of each other scan's points that contradict each of a scan's places, by state."""
    result = []
    for i, scan in enumerate(group):
        sets = []
        for j, other in enumerate(group):
            if i == j:
                continue
            points = eyes.points[other][::_EVERY]
            states = _relative(T_group_scan[i], T_group_scan[j], motion)
            sets.append(points @ states[:, :3, :3].transpose(0, 2, 1) + states[:, None, :3, 3])
        sight = eyes.sights[scan]
        found = [sight.contradicted(torch.from_numpy(some).float()).numpy().T for some in sets]
        found.insert(i, np.zeros_like(found[0]))
        result.append(np.stack(found))
    return result


def _grown(
    evidence: np.ndarray,
    contradictions: Sequence[np.ndarray],
    hidden: Sequence[np.ndarray],
    *,
    is_half_turn: bool,
) -> Bool[np.ndarray, "b n"]:
    """Which scans move in each assembly: none, and all that was looked at while sets grew.

    From every scan alone, the one that raises the score most joins, until all but one are in.
    """
    count = len(evidence)
    now = np.eye(count, dtype=bool)
    seen = [np.zeros((1, count), bool), now]
    for _ in range(count - 2):
        more = now[:, None] | np.eye(count, dtype=bool)
        flat = more.reshape(-1, count)
        said, regret = _values(flat, evidence, contradictions, hidden)
        score = _score(said, regret).reshape(count, count)
        score[now] = -np.inf
        seen.append(flat[np.isfinite(score).ravel()])
        now = more[np.arange(count), score.argmax(1)]
    labels = np.concatenate(seen)
    # Under a half turn, moving the others is the same.
    canonical = labels ^ (labels[:, :1] & is_half_turn)
    _, first = np.unique(canonical, axis=0, return_index=True)
    return labels[np.sort(first)]


def _values(
    moved: Bool[np.ndarray, "b n"],
    evidence: np.ndarray,
    contradictions: Sequence[np.ndarray],
    hidden: Sequence[np.ndarray],
) -> tuple[Float[np.ndarray, " b"], Float[np.ndarray, " b"]]:
    """The evidence of the edges and the regret of the sensors for each set of moved scans."""
    count = moved.shape[1]
    state = np.where(
        moved[:, :, None] == moved[:, None], 0, np.where(moved[:, None], 1, 2)
    )  # (b, n, n)
    i, j = np.triu_indices(count, 1)
    said = evidence[i, j, state[:, i, j]].sum(1)
    regret = np.zeros(len(moved))
    rows = np.arange(count)
    for scan in range(count):
        against = contradictions[scan][rows, state[:, scan]].sum(1)  # (b, v)
        regret += (hidden[scan] + against).min(1) - hidden[scan].min()
    return said, regret


def _score(evidence: np.ndarray, regret: np.ndarray) -> np.ndarray:
    result: np.ndarray = _OF_EDGES * evidence - _OF_REGRET * regret
    return result


def _relative(T_i: np.ndarray, T_j: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """T_i_j (3, 4, 4): as it is, the second scan moved, the first one moved."""
    back = invert(T_i)
    return np.stack([back @ T_j, back @ motion @ T_j, back @ invert(motion) @ T_j])
