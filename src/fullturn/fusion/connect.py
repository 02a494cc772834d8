"""From scans to groups with one pose each: pairs of scans first, then whole groups."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import torch

from fullturn.fusion.edges import Edge, Registrar, Sides
from fullturn.fusion.graph import GraphConfig, Placement, place_scans
from fullturn.fusion.joint import refine_joint
from fullturn.fusion.likely import ALL_PAIRS_UP_TO, PAIRS_PER_SCAN, likely_pairs, next_pairs
from fullturn.fusion.optimize import Link, optimize_poses
from fullturn.fusion.scans import Scan
from fullturn.fusion.whole import anchored, covers, current, group_body, next_attempts
from fullturn.geometry.motion import adjoint, invert
from fullturn.progress import progress_bar

_ALTERNATIVE_SIGMA = 0.02  # of a pose that isn't an edge's best, whose covariance isn't known
_REACH, _CLOSEST = 0.1, 2.5  # of the joint refinement: in units of the fusion, in spacings


def connect_scans(
    registrar: Registrar,
    scans: Sequence[Scan],
    length: float,
    surfaces: Sequence[np.ndarray],
    config: GraphConfig,
    *,
    progress: bool,
) -> tuple[list[Edge], Placement]:
    """Register pairs in rounds until the scans are connected or enough has been tried.

    `surfaces`: points (N, 3) of each scan, less its center, in units of the fusion.
    """
    count = len(scans)
    few = [(i, j) for i in range(count) for j in range(i + 1, count)]
    order = few if count <= ALL_PAIRS_UP_TO else likely_pairs(scans, length)
    edges: list[Edge] = []
    placement = place_scans(count, edges, config, surfaces=surfaces)
    number = 1
    while True:
        done = {(edge.target, edge.source) for edge in edges}
        trusted = [
            (edge.target, edge.source)
            for edge, chosen in zip(edges, placement.chosen, strict=True)
            if chosen >= 0
        ]
        todo = next_pairs(order, done, placement.groups, trusted, scans=count)
        if not todo:
            return edges, placement
        with progress_bar(f"registering, round {number}", len(todo), shown=progress) as advance:
            edges += registrar.run(scans, todo, advance)
        placement = place_scans(count, edges, config, surfaces=surfaces)
        number += 1


def connect_groups(
    registrar: Registrar,
    scans: Sequence[Scan],
    length: float,
    surfaces: Sequence[np.ndarray],
    config: GraphConfig,
    pairs: list[Edge],
    placement: Placement,
    *,
    progress: bool,
) -> tuple[list[Edge], Placement]:
    """Register whole groups, smaller ones to larger ones, while some haven't been.

    No two are tried twice, and no more than `PAIRS_PER_SCAN` × scans in all.
    """
    between: list[Edge] = []
    done: set[Sides] = set()
    while todo := next_attempts(placement.groups, done)[: PAIRS_PER_SCAN * len(scans) - len(done)]:
        poses, _ = refine_groups(scans, length, [*pairs, *between], placement)
        bodies = [group_body(group, scans, poses, length) for group in placement.groups]
        place = {group: number for number, group in enumerate(placement.groups)}
        ends = [(place[target], place[source]) for target, source in todo]
        with progress_bar("registering groups", len(todo), shown=progress) as advance:
            found = registrar.run(bodies, ends, advance)
        between += [
            anchored(edge, sides, (bodies[a], bodies[b]), poses, length)
            for edge, sides, (a, b) in zip(found, todo, ends, strict=True)
        ]
        done |= set(todo)
        between = current(between, placement.groups)
        start = replace(placement, T_group_scan=poses)  # refined, more edges agree
        placement = place_scans(
            len(scans), [*pairs, *between], config, start=start, surfaces=surfaces
        )
    return [*pairs, *between], placement


def refine_groups(
    scans: Sequence[Scan], length: float, edges: Sequence[Edge], placement: Placement
) -> tuple[np.ndarray, np.ndarray]:
    """Poses (n, 4, 4) and covariances (n, 6, 6) in units of the fusion, by scan."""
    poses = placement.T_group_scan.copy()
    covariance = np.zeros((len(scans), 6, 6))
    chosen = [(edge, pose) for edge, pose in zip(edges, placement.chosen, strict=True) if pose >= 0]
    held = [edge.sides for edge, _ in chosen if edge.held]
    for group in placement.groups:
        if len(group) == 1:
            continue
        members = list(group)
        place = {scan: number for number, scan in enumerate(members)}
        links: list[Link] = []
        for edge, pose in chosen:
            # What whole groups say stands for the pairs of their scans.
            is_heard = edge.held is None and any(covers(sides, edge.sides) for sides in held)
            if edge.target in place and not is_heard:
                links += _links(edge, pose, placement.T_group_scan, place)
        poses[members], covariance[members] = optimize_poses(poses[members], links)
        spacing = float(np.median([scans[s].sample_spacing for s in members])) / length
        poses[members] = refine_joint(
            torch.from_numpy(poses[members]),
            [scans[s].sample / length for s in members],
            [scans[s].sample_normals for s in members],
            reach=max(_REACH, _CLOSEST * spacing),
            closest=_CLOSEST * spacing,
        ).numpy()
    return poses, covariance


def _links(
    edge: Edge, pose: int, T_group_scan: np.ndarray, place: dict[int, int]
) -> Iterator[Link]:
    """What an edge says of the scans at both ends, their places given; together, as much as once.

    Each end keeps its shape: with T_a_target and T_source_b, T_a_b = T_a_target T T_source_b.
    """
    covariance = edge.covariance if pose == 0 else _ALTERNATIVE_SIGMA**2 * np.eye(6)
    pairs = [(a, b) for a, b in product(*edge.sides) if a in place and b in place]
    for a, b in pairs:
        T_a_target = invert(T_group_scan[a]) @ T_group_scan[edge.target]
        T_source_b = invert(T_group_scan[edge.source]) @ T_group_scan[b]
        there = adjoint(invert(T_source_b))
        yield Link(
            place[a],
            place[b],
            T_a_target @ edge.T_target_source[pose] @ T_source_b,
            len(pairs) * there @ covariance @ there.T,
        )
