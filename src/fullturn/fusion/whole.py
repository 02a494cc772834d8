"""Whole groups registered as one cloud each: they overlap more than any two of their scans do."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence, Set
from dataclasses import replace

import numpy as np

from fullturn.fusion.edges import Edge, Sides
from fullturn.fusion.merge import merge_clouds
from fullturn.fusion.scans import Body, Scan
from fullturn.geometry.motion import adjoint, invert
from fullturn.io import LoadedCloud

_CELL = 1.5  # of a group's cloud, in spacings of what is kept of its scans


def next_attempts(groups: Sequence[tuple[int, ...]], done: Set[Sides]) -> list[Sides]:
    """Which groups to register next: all smaller ones to the largest that is not done with them.

    Lone scans are registered to groups alone: one another they have met as a pair.
    """
    for place, largest in enumerate(groups):
        todo = [(largest, other) for other in groups[place + 1 :] if (largest, other) not in done]
        if todo and len(largest) > 1:
            return todo
    return []


def group_body(
    group: Sequence[int], scans: Sequence[Scan], T_group_scan: np.ndarray, length: float
) -> Body:
    """The scans of a group as one cloud in the group's frame; a lone scan is itself.

    Poses are in units of the fusion, relative to the scans' centers, as those of edges are.
    """
    if len(group) == 1:
        return scans[group[0]]
    poses = [T_group_scan[scan] for scan in group]
    spacing = float(np.median([scans[scan].sample_spacing for scan in group]))
    moved = (
        scans[scan].sample.numpy() @ T[:3, :3].T + length * T[:3, 3]
        for scan, T in zip(group, poses, strict=True)
    )
    points = merge_clouds(moved, _CELL * spacing or 1e-6 * length).points
    keys = "\n".join((*(scans[scan].key for scan in group), repr(length)))
    content = keys.encode() + np.stack(poses).tobytes()
    return Body(
        key=hashlib.sha256(content).hexdigest(),
        origin=LoadedCloud(points),
        center=points.mean(axis=0),
        viewpoint=None,
    )


def anchored(
    edge: Edge,
    sides: Sides,
    bodies: tuple[Body, Body],
    T_group_scan: np.ndarray,
    length: float,
) -> Edge:
    """An edge between two groups' clouds as one between the first scans of both.

    With T_A_B between the clouds and T_A_i, T_B_j where the two scans stand in them, T_i_j is
    T_A_i⁻¹ T_A_B T_B_j, and a small motion ξ at the right of T_A_B is Ad(T_B_j⁻¹) ξ there.
    """
    T_A_i, T_B_j = (
        _in_body(T_group_scan[side[0]], body, length, alone=len(side) == 1)
        for side, body in zip(sides, bodies, strict=True)
    )
    there = adjoint(invert(T_B_j))
    return replace(
        edge,
        target=sides[0][0],
        source=sides[1][0],
        T_target_source=invert(T_A_i) @ edge.T_target_source @ T_B_j,
        covariance=there @ edge.covariance @ there.T,
        held=sides,
    )


def current(edges: Sequence[Edge], groups: Sequence[tuple[int, ...]]) -> list[Edge]:
    """The edges between groups that still say something, of those in the order they were made.

    An edge falls when one of its sides is no longer within one group, or when a later one holds
    both of its sides: the same scans must not be heard twice.
    """
    kept: list[Edge] = []
    for edge in reversed(edges):
        whole = all(any({*side} <= {*group} for group in groups) for side in edge.sides)
        if whole and not any(covers(later.sides, edge.sides) for later in kept):
            kept.append(edge)
    return kept[::-1]


def covers(sides: Sides, others: Sides) -> bool:
    """Whether the first two groups hold those of the others, one each."""
    (a, b), (c, d) = ([{*side} for side in both] for both in (sides, others))
    return (c <= a and d <= b) or (c <= b and d <= a)


def _in_body(T_group_scan: np.ndarray, body: Body, length: float, *, alone: bool) -> np.ndarray:
    """Where a scan stands in the cloud of its group, whose frame is centered on its mean."""
    if alone:
        return np.eye(4)
    T = T_group_scan.copy()
    T[:3, 3] -= body.center / length
    return T
