"""Every scan of a group once more, against all the others as one cloud: they see it whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from fullturn.fusion.edges import Edge, Registrar
from fullturn.fusion.graph import GraphConfig, Placement, join_groups, placement_at
from fullturn.fusion.posterior import agree_here
from fullturn.fusion.scans import Scan
from fullturn.fusion.settle import MOST_SCANS
from fullturn.fusion.whole import anchored, group_body
from fullturn.progress import progress_bar

_LEAST_SCANS = 4
_ROUNDS = 3
# Another pose is tried with this probability, where the present one has less than half of that.
_LEAST, _BESIDE = 0.3, 0.5
_LEAST_HERE = 0.01  # what a scan says of its place at least
# A scan is lost where nothing is found for it in the rest, the present pose included.
_NOWHERE, _NOT_HERE = 0.85, 0.1
_MOST_LOST = 0.5  # of a group that stands


def recheck_scans(
    registrar: Registrar,
    scans: Sequence[Scan],
    length: float,
    surfaces: Sequence[np.ndarray],
    config: GraphConfig,
    edges: Sequence[Edge],
    placement: Placement,
    T_group_scan: np.ndarray,
    *,
    progress: bool,
) -> tuple[list[Edge], Placement, bool]:
    """Move scans that the rest of their group places elsewhere, if the others agree.

    Groups of 4 to 16 scans are looked at, at poses (n, 4, 4) that are refined. What moved a scan is
    an edge more; groups that all edges connect then join. A group of which half or more find no
    place in the rest falls apart into single scans. Also returned: whether anything changed.
    """
    ask = partial(_asked, registrar, scans, length, progress=progress)
    poses = T_group_scan.copy()
    moved_by: list[Edge] = []
    groups, lost = list[Sequence[int]](), set[int]()
    for group in placement.groups:
        groups.append(group)
        if not _LEAST_SCANS <= len(group) <= MOST_SCANS:
            continue
        asked, moved = ask(group, poses), set[int]()
        if sum(_is_lost(edge, poses, config) for edge in asked) >= _MOST_LOST * len(group):
            groups[-1:] = [(scan,) for scan in group]
            lost |= {*group}
            poses[list(group)] = np.eye(4)
            continue
        for _ in range(_ROUNDS):
            tried = _tried(asked, poses, config)
            if tried is None:
                break
            scan, others = tried
            again = ask(group, others)
            stand = {e.source for e in again if _here(e, others, config).any()}
            more = _support(again, others, config) > _support(asked, poses, config)
            if not more or not moved | {scan} <= stand:
                break
            poses, asked, moved = others, again, moved | {scan}
        moved_by += [edge for edge in asked if edge.source in moved]
    if not moved_by and not lost:
        return list(edges), placement, False
    edges = [*edges, *moved_by]
    result = placement_at(edges, groups, poses, config)
    if moved_by:
        heard = [edge for edge in edges if lost.isdisjoint((edge.target, edge.source))]
        result = join_groups(heard, result, config, surfaces=surfaces)
        result = placement_at(edges, result.groups, result.T_group_scan, config)
    probability = placement.probability.copy()
    fresh = [scan for group in result.groups if group not in placement.groups for scan in group]
    before, now = probability[fresh], result.probability[fresh]
    probability[fresh] = np.where(np.isnan(before), now, np.minimum(before, now))
    for edge in moved_by:
        probability[edge.source] = _stated(edge, poses, config)
    return edges, replace(result, probability=probability), True


def _asked(
    registrar: Registrar,
    scans: Sequence[Scan],
    length: float,
    group: Sequence[int],
    T_group_scan: np.ndarray,
    *,
    progress: bool,
) -> list[Edge]:
    """Each scan of a group registered to all its others as one cloud."""
    rests = [tuple(other for other in group if other != scan) for scan in group]
    wholes = [group_body(rest, scans, T_group_scan, length) for rest in rests]
    lone = [scans[scan] for scan in group]
    count = len(group)
    with progress_bar("registering each to the rest", count, shown=progress) as advance:
        ends = [(number, count + number) for number in range(count)]
        found = registrar.run([*wholes, *lone], ends, advance)
    return [
        anchored(edge, (rest, (scan,)), (whole, one), T_group_scan, length)
        for edge, rest, scan, whole, one in zip(found, rests, group, wholes, lone, strict=True)
    ]


def _here(edge: Edge, T_group_scan: np.ndarray, config: GraphConfig) -> np.ndarray:
    """Which poses of an edge agree with the present one."""
    T_target, T_source = T_group_scan[[edge.target, edge.source]]
    return agree_here(edge.T_target_source, T_target, T_source, config)


def _stated(edge: Edge, T_group_scan: np.ndarray, config: GraphConfig) -> float:
    """The probability that an edge gives to the present pose."""
    return float(edge.probability @ _here(edge, T_group_scan, config))


def _is_lost(edge: Edge, T_group_scan: np.ndarray, config: GraphConfig) -> bool:
    """Whether the rest of its group has no place for a scan."""
    return edge.none >= _NOWHERE and _stated(edge, T_group_scan, config) < _NOT_HERE


def _support(asked: Sequence[Edge], T_group_scan: np.ndarray, config: GraphConfig) -> float:
    """How surely all scans stand where the others of their group would place them."""
    stated = [_stated(edge, T_group_scan, config) for edge in asked]
    return float(np.log(np.maximum(stated, _LEAST_HERE)).sum())


def _tried(
    asked: Sequence[Edge], T_group_scan: np.ndarray, config: GraphConfig
) -> tuple[int, np.ndarray] | None:
    """The scan whose edge speaks most for another pose of it, and all poses with that one."""
    best, found = 0.0, None
    for edge in asked:
        here = _here(edge, T_group_scan, config)
        stated = float(edge.probability @ here)
        for p, T in zip(edge.probability[~here], edge.T_target_source[~here], strict=True):
            if p >= max(_LEAST, best) and stated < _BESIDE * p:
                moved = T_group_scan.copy()
                moved[edge.source] = moved[edge.target] @ T
                best, found = float(p), (edge.source, moved)
    return found
