"""From edges with ranked poses to groups of scans, one pose each: cycles decide.

What edges say of a relative pose is in `posterior`. Paths over a third scan speak in the same way,
which is how cycles decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from fullturn.fusion.edges import Edge
from fullturn.fusion.posterior import AgreementConfig, Measurement, agree, posterior
from fullturn.geometry.motion import invert


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
) -> Placement:
    """Join `count` scans into groups by the edges that agree with one another.

    With a `start`, its groups stand, as far as nothing speaks against them, and grow.
    """
    config = config or GraphConfig()
    graph = _Graph(count, _pool(edges), config, start)
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


def _pool(edges: Sequence[Edge]) -> dict[frozenset[int], list[Edge]]:
    """The edges that state probable poses, by the two scans that they connect."""
    pool: dict[frozenset[int], list[Edge]] = {}
    for edge in edges:
        if edge.probability.any():
            pool.setdefault(frozenset((edge.target, edge.source)), []).append(edge)
    return pool


class _Graph:
    """Scans in groups that grow; each group has a frame, that of one of its scans."""

    def __init__(
        self,
        count: int,
        pool: dict[frozenset[int], list[Edge]],
        config: GraphConfig,
        start: Placement | None,
    ) -> None:
        self.count, self.pool, self.config = count, pool, config
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
            )
            for edge in self.pool[frozenset((i, j))]
        ]

    def join(self) -> None:
        """Join groups while any two are firmly connected; symmetric poses only when none are."""
        known: dict[tuple[int, int], tuple[np.ndarray, float, float, bool]] = {}
        while self._join_one(known, symmetric=False) or self._join_one(known, symmetric=True):
            pass

    def reconsider(self) -> bool:
        """Move, or set apart, each scan that the rest of its group would place elsewhere."""
        changed = False
        for scan in range(self.count):
            rest = [s for s in self.members(self.label[scan]) if s != scan]
            if not rest:
                continue
            T, probability, none = self._relative(rest, [scan], as_new=True)
            if none > 0.5:
                self.label[scan] = self.next_label
                self.next_label += 1
                changed = True
                continue
            here = agree(self.poses[scan][None], T[:1], np.zeros(3), self.config)[0, 0]
            if not here and probability[0] >= self.config.min_probability:
                self.poses[scan] = T[0]
                changed = True
        return changed

    def split(self) -> None:
        """Set apart what no agreeing edge connects."""
        labels = [-1] * self.count
        for start in range(self.count):
            if labels[start] >= 0:
                continue
            labels[start], waiting = start, [start]
            while waiting:
                scan = waiting.pop()
                for other in self.neighbors[scan]:
                    agree_here = (self._agreeing(e) for e in self.pool[frozenset((scan, other))])
                    if labels[other] < 0 and any(pose >= 0 for pose in agree_here):
                        labels[other] = start
                        waiting.append(other)
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
                T, shares, _ = self._relative(rest, [scan], as_new=True)
                here = agree(self.poses[scan][None], T, np.zeros(3), self.config)[0]
                probability[scan] = min(1.0, float(shares[here].sum()))  # rounding alone exceeds it
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
                heard.append(Measurement(T, p, 1.0 - float(p.sum())))
        T, probability, _ = posterior(heard, np.zeros(3), self.config)
        said = np.concatenate([measurement.T_one_other for measurement in direct])
        is_direct = agree(T, said, np.zeros(3), self.config).any(1)
        return float(probability[is_direct].max(initial=0.0))

    def _join_one(
        self,
        known: dict[tuple[int, int], tuple[np.ndarray, float, float, bool]],
        *,
        symmetric: bool,
    ) -> bool:
        for _, i, j in self.order:
            a, b = self.label[i], self.label[j]
            if a == b:
                continue
            if (a, b) not in known:
                known[a, b] = self._connection(a, b)
            T, best, none, is_symmetric = known[a, b]
            # Turns of a symmetric shape onto itself are equally right.
            sure = 1.0 - none if symmetric and is_symmetric else best
            if sure < self.config.min_probability:
                continue
            joined = self.members(b)
            self.poses[joined] = T @ self.poses[joined]
            for scan in [*self.members(a), *joined]:
                self.label[scan] = self.next_label
            self.next_label += 1
            return True
        return False

    def _connection(self, a: int, b: int) -> tuple[np.ndarray, float, float, bool]:
        one, other = self.members(a), self.members(b)
        heard, middle = self._heard(one, other)
        T, probability, none = posterior(heard, middle, self.config)
        if not any(self._is_firm(m, T[0], middle) for m in heard):
            return T[0], 0.0, 1.0, False
        linking = [self.pool[frozenset((i, j))] for i in one for j in self.neighbors[i] & {*other}]
        is_symmetric = all(edge.is_symmetric for edges in linking for edge in edges)
        return T[0], float(probability[0]), none, is_symmetric

    def _is_firm(self, said: Measurement, T: np.ndarray, at: np.ndarray) -> bool:
        here = agree(T[None], said.T_one_other, at, self.config)[0]
        share = float(said.probability[here].sum())
        return said.doubt <= self.config.most_doubt and share >= self.config.least_share

    def _relative(
        self, one: Sequence[int], other: Sequence[int], *, as_new: bool = False
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """What the edges between two sets of scans say of their frames' relative pose.

        With `as_new`, the others' present poses are forgotten: each frame is its scan's own.
        """
        heard, middle = self._heard(one, other, as_new=as_new)
        if not heard:
            return np.zeros((0, 4, 4)), np.zeros(0), 1.0
        return posterior(heard, middle, self.config)

    def _heard(
        self, one: Sequence[int], other: Sequence[int], *, as_new: bool = False
    ) -> tuple[list[Measurement], np.ndarray]:
        """The edges between two sets of scans, between their frames, and the others' middle."""
        heard = []
        for i in one:
            for j in sorted(self.neighbors[i].intersection(other)):
                back = np.eye(4) if as_new else invert(self.poses[j])
                for said in self.between(i, j):
                    T = self.poses[i] @ said.T_one_other @ back
                    heard.append(Measurement(T, said.probability, said.doubt))
        middle = np.zeros(3) if as_new else self.poses[list(other), :3, 3].mean(0)
        return heard, middle

    def _agreeing(self, edge: Edge) -> int:
        """Which pose of an edge agrees with the present ones; −1: none, or in other groups."""
        i, j = edge.target, edge.source
        if self.label[i] != self.label[j] or not len(edge.probability):
            return -1
        now = (invert(self.poses[i]) @ self.poses[j])[None]
        fits = np.flatnonzero(agree(now, edge.T_target_source, np.zeros(3), self.config)[0])
        return int(fits[0]) if len(fits) else -1
