"""The edges of the graph: pairs of scans, registered, each with its ranked poses."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

import fullturn
from fullturn.api import register
from fullturn.errors import FullturnError, one_line
from fullturn.fusion.cache import EdgeCache
from fullturn.fusion.scans import Body
from fullturn.io import LoadedCloud
from fullturn.methods.fingerprint import REGISTER, fingerprint
from fullturn.methods.registry import get
from fullturn.result import Registration
from fullturn.workers import Crew, attempt

Pair = tuple[int, int]  # target and source, places in the list of usable scans
Sides = tuple[tuple[int, ...], tuple[int, ...]]  # the scans that were registered as one cloud each

# Of 149 edges of views of `val` meshes that any angle will do for, and whose poses have this much
# together, 3 were wrong beyond a turn, whatever they doubt.
_LEAST_SAID, _NO_TURN = 0.2, 0.05


@dataclass(frozen=True, eq=False)
class Edge:
    """One registered pair, frames centered on the scans.

    Lengths are in units of the fusion. The cache keeps them in the input's unit, so that a pair is
    the same among any other scans.
    """

    target: int
    source: int
    T_target_source: np.ndarray  # (k, 4, 4) distinct poses, best first; none where it failed
    probability: np.ndarray  # (k,) summing to at most 1
    overlap: tuple[tuple[float, float], ...]  # of each pose: target share second, as registered
    covariance: np.ndarray  # (6, 6) of the best pose, right perturbation
    symmetry: int | None = None  # the order, where the poses are turns of the source onto itself
    error: str | None = None
    held: Sides | None = None  # where whole groups were registered: which, the target's first

    @property
    def sides(self) -> Sides:
        """The scans at both ends that were registered as one cloud each."""
        return self.held or ((self.target,), (self.source,))

    @property
    def doubt(self) -> float:
        """The probability that none of the poses is right."""
        return max(0.0, 1.0 - float(self.probability.sum()))

    @property
    def none(self) -> float:
        """The probability that not even another turn of a symmetric shape would be right.

        Where any angle will do, the poses stand for few of all the turns that are equally right,
        and most of the doubt speaks for others of these.
        """
        said = 1.0 - self.doubt
        any_turn = self.symmetry == 0 and said >= _LEAST_SAID
        return min(self.doubt, _NO_TURN) if any_turn else self.doubt


def edge_of(target: int, source: int, result: Registration) -> Edge:
    """The edge that a registration states."""
    others = result.alternatives
    return Edge(
        target,
        source,
        np.stack([result.T_target_source, *(other.T_target_source for other in others)]),
        np.array([result.success_probability, *(other.success_probability for other in others)]),
        (result.overlap, *(other.overlap for other in others)),
        result.covariance,
        None if result.symmetry is None else result.symmetry.order,
    )


def in_unit(edge: Edge, length: float) -> Edge:
    """An edge in the input's unit in units of that length."""
    T, covariance = edge.T_target_source.copy(), edge.covariance.copy()
    T[:, :3, 3] /= length
    covariance[3:] /= length
    covariance[:, 3:] /= length
    return replace(edge, T_target_source=T, covariance=covariance)


def failed_edge(target: int, source: int, error: object) -> Edge:
    """An edge without poses, with the reason."""
    return Edge(
        target, source, np.zeros((0, 4, 4)), np.zeros(0), (), np.eye(6), None, one_line(error)
    )


def pair_key(method: str, seed: int) -> Callable[[Body, Body], str]:
    """What a registration depends on, hashed: both clouds, the method's code and seed."""
    # Clouds of whole groups are made from their scans by code of their own.
    code, _ = fingerprint(get(method), roots=(*REGISTER, "fullturn.fusion.whole"))
    settings = f"{fullturn.__version__} {code} {seed}"

    def key(target: Body, source: Body) -> str:
        return hashlib.sha256(f"{target.key} {source.key} {settings}".encode()).hexdigest()

    return key


class Registrar:
    """Registers pairs of clouds, in worker processes if there are several, and keeps the results.

    Leaving the block stops the workers; what is finished stays in the cache.
    """

    def __init__(
        self,
        *,
        length: float,
        method: str,
        seed: int,
        workers: int,
        cache: EdgeCache | None = None,
    ) -> None:
        self._length, self._cache = length, cache
        self._work = partial(_registered, method=method, seed=seed)
        self._crew = Crew(self._work, workers=workers) if workers > 1 else None
        self._key = None if cache is None else pair_key(method, seed)

    def __enter__(self) -> Registrar:
        return self

    def __exit__(self, *error: object) -> None:
        if self._crew is not None:
            self._crew.__exit__(*error)

    def run(
        self, bodies: Sequence[Body], pairs: Iterable[Pair], advance: Callable[[int], None]
    ) -> list[Edge]:
        """One edge per pair of bodies, in the order of the pairs; `advance` is told of each."""
        todo = list(pairs)
        edges: list[Edge | None] = [self._found(bodies, pair) for pair in todo]
        missing = [number for number, edge in enumerate(edges) if edge is None]
        advance(len(todo) - len(missing))
        ends = [(bodies[target], bodies[source]) for target, source in todo]
        tasks = [ends[number] for number in missing]

        def done(place: int, outcome: Any) -> None:
            target, source = todo[missing[place]]
            is_error = isinstance(outcome, FullturnError)
            edge = (failed_edge if is_error else edge_of)(target, source, outcome)
            edges[missing[place]] = in_unit(edge, self._length)
            # A failure may be due to this run alone, such as too little memory.
            if self._cache is not None and self._key is not None and not is_error:
                self._cache.add(self._key(*ends[missing[place]]), _fields(edge))
            advance(1)

        if self._crew is None or len(tasks) < 2:
            for place, task in enumerate(tasks):
                done(place, attempt(self._work, task))
        else:
            self._crew.run(tasks, done, portable=_portable)
        return [edge for edge in edges if edge is not None]

    def _found(self, bodies: Sequence[Body], pair: Pair) -> Edge | None:
        if self._cache is None or self._key is None:
            return None
        fields = self._cache.get(self._key(*(bodies[number] for number in pair)))
        return None if fields is None else in_unit(_edge(*pair, fields), self._length)


def _portable(task: tuple[Body, Body]) -> tuple[Body, Body]:
    """The task without what only this process needs."""
    target, source = (Body(body.key, body.origin, body.center, body.viewpoint) for body in task)
    return target, source


def _registered(task: tuple[Body, Body], *, method: str, seed: int) -> Registration:
    target, source = task
    eyes = {
        f"{role}_viewpoint": body.viewpoint - body.center
        for role, body in (("source", source), ("target", target))
        if body.viewpoint is not None
    }
    return register(
        LoadedCloud(source.points(), name="source"),
        LoadedCloud(target.points(), name="target"),
        method=method,
        seed=seed,
        **eyes,
    )


def _fields(edge: Edge) -> dict[str, Any]:
    return {
        "T_target_source": edge.T_target_source.tolist(),
        "probability": edge.probability.tolist(),
        "overlap": [list(shares) for shares in edge.overlap],
        "covariance": edge.covariance.tolist(),
        "symmetry": edge.symmetry,
    }


def _edge(target: int, source: int, fields: dict[str, Any]) -> Edge:
    return Edge(
        target,
        source,
        np.array(fields["T_target_source"]),
        np.array(fields["probability"]),
        tuple((a, b) for a, b in fields["overlap"]),
        np.array(fields["covariance"]),
        fields["symmetry"],
    )
