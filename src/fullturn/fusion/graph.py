"""From edges with ranked poses to groups of scans, one pose each: cycles decide.

What edges say of a relative pose is in `posterior`. Paths over a third scan speak in the same way,
which is how cycles decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from fullturn.fusion.edges import Edge
from fullturn.fusion.posterior import (
    AgreementConfig,
    Measurement,
    Posterior,
    agree,
    agree_here,
    posterior,
)
from fullturn.fusion.turns import Surface, same_but_for_turns
from fullturn.geometry.motion import invert, move

_SAME = 0.005  # of its size: how near a group lies to itself, turned, where turns don't matter


@dataclass(frozen=True)
class GraphConfig(AgreementConfig):
    """When two poses agree, and what it takes to join scans."""

    min_probability: float = 0.8  # to join two groups
    # … by one firm edge at least: many weak ones often share one mistake, as on shapes that are
    # nearly symmetric. It doubts no more than this, and gives the pose at least this probability.
    most_doubt: float = 0.5
    least_share: float = 0.2
    sweeps: int = 4  # rounds in which every scan is asked again; two may send each other to and fro


@dataclass(frozen=True, eq=False)
class Placement:
    """Groups of scans, the largest first, and where their scans are."""

    groups: tuple[tuple[int, ...], ...]
    T_group_scan: np.ndarray  # (n, 4, 4), in the frame of the group's first scan
    probability: np.ndarray  # (n,) of each pose, given the rest of its group; NaN for a lone scan
    chosen: tuple[int, ...]  # of each edge: the pose that agrees with the placement, or −1


def place_scans(
    count: int,
    edges: Sequence[Edge],
    config: GraphConfig | None = None,
    *,
    start: Placement | None = None,
    surfaces: Sequence[np.ndarray] | None = None,
) -> Placement:
    """Join `count` scans into groups by the edges that agree with one another.

    With a `start`, its groups stand, as far as nothing speaks against them, and grow. With
    `surfaces`, points (N, 3) of each scan in its frame, poses that differ by a turn of a whole
    group onto itself agree where nothing else joins.
    """
    config = config or GraphConfig()
    graph = _Graph(count, _pool(edges), config, start, surfaces)
    graph.join()
    for _ in range(config.sweeps):
        if not graph.reconsider():
            break
        graph.join()
    graph.split()
    return graph.placement(edges)


def placement_at(
    edges: Sequence[Edge],
    groups: Sequence[Sequence[int]],
    T_group_scan: np.ndarray,
    config: GraphConfig,
) -> Placement:
    """What the edges say of groups and poses (n, 4, 4) found otherwise; nothing moves.

    What no agreeing edge connects is set apart.
    """
    unknown = np.full(len(T_group_scan), np.nan)
    start = Placement(tuple(map(tuple, groups)), T_group_scan, unknown, ())
    graph = _Graph(len(T_group_scan), _pool(edges), config, start)
    graph.split()
    return graph.placement(edges)


def join_groups(
    edges: Sequence[Edge],
    placement: Placement,
    config: GraphConfig,
    *,
    surfaces: Sequence[np.ndarray] | None = None,
) -> Placement:
    """The placement with groups joined that these edges connect; within groups, nothing moves."""
    graph = _Graph(len(placement.T_group_scan), _pool(edges), config, placement, surfaces)
    graph.join()
    return graph.placement(edges)


def _pool(edges: Sequence[Edge]) -> dict[frozenset[int], list[Edge]]:
    """The edges that state probable poses, by the two scans that they connect."""
    pool: dict[frozenset[int], list[Edge]] = {}
    for edge in edges:
        if edge.probability.any():
            pool.setdefault(frozenset((edge.target, edge.source)), []).append(edge)
    return pool


_Known = dict[tuple[int, int], tuple[np.ndarray, float]]  # by two groups: pose and probability


class _Graph:
    """Scans in groups that grow; each group has a frame, that of one of its scans."""

    def __init__(
        self,
        count: int,
        pool: dict[frozenset[int], list[Edge]],
        config: GraphConfig,
        start: Placement | None,
        surfaces: Sequence[np.ndarray] | None = None,
    ) -> None:
        self.count, self.pool, self.config = count, pool, config
        self.surfaces = surfaces
        self.poses = (
            np.tile(np.eye(4), (count, 1, 1)) if start is None else start.T_group_scan.copy()
        )
        self.label = list(range(count))  # of each scan's group
        for group in start.groups if start is not None else ():
            for scan in group:
                self.label[scan] = group[0]
        self.next_label = count
        self.neighbors: dict[int, set[int]] = {scan: set() for scan in range(count)}
        for pair in pool:
            a, b = pair
            self.neighbors[a].add(b)
            self.neighbors[b].add(a)

    @cached_property
    def order(self) -> list[tuple[float, int, int]]:
        """All pairs, that of the most supported pose first, which takes all paths over thirds."""
        pairs = [(min(pair), max(pair)) for pair in self.pool]
        return sorted((-self._supported(i, j), i, j) for i, j in pairs)

    def between(self, i: int, j: int) -> list[Measurement]:
        """What the edges of two scans say of T_i_j."""
        return [
            Measurement(
                edge.T_target_source if edge.target == i else invert(edge.T_target_source),
                edge.probability,
                edge.doubt,
                edge.none,
            )
            for edge in self.pool[frozenset((i, j))]
        ]

    def join(self) -> None:
        """Join groups while any two are firmly connected; symmetric poses only when none are."""
        by_pose: _Known = {}
        by_turn: _Known = {}
        while self._join_one(by_pose) or self._join_one(by_turn, but_for_turns=True):
            pass

    def reconsider(self) -> bool:
        """Move, or set apart, each scan that the rest of its group would place elsewhere."""
        changed = False
        for scan in range(self.count):
            rest = [s for s in self.members(self.label[scan]) if s != scan]
            if not rest:
                continue
            found = self._relative(rest, [scan])
            if found is None or found.none > 0.5:
                self.label[scan] = self.next_label
                self.next_label += 1
                changed = True
                continue
            best = found.T_one_other[:1]
            here = agree(self.poses[scan][None], best, np.zeros(3), self.config)[0, 0]
            if not here and found.probability[0] >= self.config.min_probability:
                self.poses[scan] = best[0]
                changed = True
        return changed

    def split(self) -> None:
        """Set apart what no agreeing edge connects; one between groups holds all their scans."""
        labels = list(range(self.count))
        for edge in (edge for edges in self.pool.values() for edge in edges):
            if self._agreeing(edge) < 0:
                continue
            held = (scan for side in edge.sides for scan in side)
            joined = {labels[s] for s in held if self.label[s] == self.label[edge.target]}
            labels = [min(joined) if label in joined else label for label in labels]
        self.label = labels

    def placement(self, edges: Sequence[Edge]) -> Placement:
        groups = [tuple(self.members(label)) for label in dict.fromkeys(self.label)]
        groups.sort(key=lambda group: (-len(group), group))
        probability = np.full(self.count, np.nan)
        poses = self.poses.copy()
        for group in groups:
            poses[list(group)] = invert(self.poses[[group[0]]]) @ self.poses[list(group)]
            for scan in group if len(group) > 1 else ():
                rest = [s for s in group if s != scan]
                found = self._relative(rest, [scan])
                probability[scan] = 0.0
                if found is not None:
                    at = (found.T_one_other, np.zeros(3), self.config)
                    here = agree(self.poses[scan][None], *at)[0]
                    # Rounding alone exceeds 1.
                    probability[scan] = min(1.0, float(found.probability[here].sum()))
        chosen = tuple(self._agreeing(edge) for edge in edges)
        return Placement(tuple(groups), poses, probability, chosen)

    def members(self, label: int) -> list[int]:
        return [scan for scan in range(self.count) if self.label[scan] == label]

    def _supported(self, i: int, j: int) -> float:
        """The probability of the best pose of an edge, the paths over third scans heard."""
        direct = self.between(i, j)
        heard = list(direct)
        for k in sorted(self.neighbors[i] & self.neighbors[j]):
            for first, second in product(self.between(i, k), self.between(k, j)):
                p = (first.probability[:, None] * second.probability).ravel()
                T = (first.T_one_other[:, None] @ second.T_one_other).reshape(-1, 4, 4)
                doubt = 1.0 - float(p.sum())
                heard.append(Measurement(T, p, doubt, doubt))
        found = posterior(heard, np.zeros(3), self.config)
        said = np.concatenate([measurement.T_one_other for measurement in direct])
        is_direct = agree(found.T_one_other, said, np.zeros(3), self.config).any(1)
        return float(found.probability[is_direct].max(initial=0.0))

    def _join_one(self, known: _Known, *, but_for_turns: bool = False) -> bool:
        for _, i, j in self.order:
            a, b = self.label[i], self.label[j]
            if a == b:
                continue
            if (a, b) not in known:
                known[a, b] = self._connection(a, b, but_for_turns=but_for_turns)
            T, sure = known[a, b]
            if sure < self.config.min_probability:
                continue
            joined = self.members(b)
            self.poses[joined] = T @ self.poses[joined]
            for scan in [*self.members(a), *joined]:
                self.label[scan] = self.next_label
            self.next_label += 1
            return True
        return False

    def _connection(self, a: int, b: int, *, but_for_turns: bool) -> tuple[np.ndarray, float]:
        """The best relative pose of two groups, and its probability; 0 where no edge is firm.

        Turns of a symmetric shape onto itself are equally right: if wanted, all count together,
        where all edges that say something name nothing else, or where they leave a group as it is.
        """
        one, other = self.members(a), self.members(b)
        least, most = self.config.least_share, self.config.most_doubt
        linking = [self.pool[frozenset((i, j))] for i in one for j in self.neighbors[i] & {*other}]
        speaking = [e for edges in linking for e in edges if e.probability.sum() >= least]
        if not speaking:
            return np.eye(4), 0.0
        heard = self._heard(one, other)
        middle = self.poses[other, :3, 3].mean(0)
        is_turn = self._turns(one, other, heard) if but_for_turns else None
        found = posterior(heard, middle, self.config, is_turn)
        best = found.T_one_other[0]
        if but_for_turns and all(edge.symmetry is not None for edge in speaking):
            return best, 1.0 - found.none if min(edge.none for edge in speaking) <= most else 0.0
        firm = (
            m.none <= most and share >= least
            for m, share in zip(heard, found.shares[0], strict=True)
        )
        return best, float(found.probability[0]) if any(firm) else 0.0

    def _turns(
        self, one: Sequence[int], other: Sequence[int], heard: Sequence[Measurement]
    ) -> np.ndarray | None:
        """Which of the poses that are heard differ by a turn of either group onto itself."""
        if self.surfaces is None:
            return None
        shapes = (
            Surface(np.concatenate([move(self.poses[scan], self.surfaces[scan]) for scan in group]))
            for group in (one, other)
        )
        T, p = (
            np.concatenate([getattr(m, name) for m in heard])
            for name in ("T_one_other", "probability")
        )
        return same_but_for_turns(T, p, *shapes, within=_SAME)

    def _relative(self, one: Sequence[int], other: Sequence[int]) -> Posterior | None:
        """What the edges say of the relative pose of a placed set and one that isn't."""
        heard = self._heard(one, other, as_new=True)
        return posterior(heard, np.zeros(3), self.config) if heard else None

    def _heard(
        self, one: Sequence[int], other: Sequence[int], *, as_new: bool = False
    ) -> list[Measurement]:
        """The edges between two sets of scans, between their frames.

        With `as_new`, the others' present poses are forgotten: each frame is its scan's own.
        """
        heard = []
        for i in one:
            for j in sorted(self.neighbors[i].intersection(other)):
                back = np.eye(4) if as_new else invert(self.poses[j])
                heard += [
                    replace(said, T_one_other=self.poses[i] @ said.T_one_other @ back)
                    for said in self.between(i, j)
                ]
        return heard

    def _agreeing(self, edge: Edge) -> int:
        """Which pose of an edge agrees with the present ones; −1: none, or in other groups."""
        i, j = edge.target, edge.source
        if self.label[i] != self.label[j] or not len(edge.probability):
            return -1
        here = agree_here(edge.T_target_source, self.poses[i], self.poses[j], self.config)
        fits = np.flatnonzero(here)
        return int(fits[0]) if len(fits) else -1
