"""The last word on groups: rivals that fit what all sensors saw, and scans that aren't sure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fullturn.fusion.edges import Edge
from fullturn.fusion.graph import GraphConfig, Placement, placement_at
from fullturn.fusion.rivals import Eyes, judge_group
from fullturn.fusion.scans import Scan
from fullturn.geometry.motion import invert

MOST_SCANS = 16  # of a group: the work grows with the fourth power of them
_ROUNDS = 3
_TOGETHER = 0.65  # probability below which two scans part; the best of three on `train` meshes


def settle_groups(
    scans: Sequence[Scan],
    length: float,
    edges: Sequence[Edge],
    placement: Placement,
    T_group_scan: np.ndarray,
    config: GraphConfig,
) -> tuple[Placement, bool]:
    """The placement that survives its rivals, and whether poses or groups are others now.

    Groups of 3 to 16 scans are judged, unless all of their viewpoints are known. Poses (n, 4, 4)
    are the refined ones. What is sure of one another stays together; a scan's probability is at
    most the mean of its own to the rest.
    """
    poses, groups, changed = T_group_scan.copy(), [], False
    together = np.ones((len(scans), len(scans)))
    moved: set[int] = set()
    for group in placement.groups:
        members = list(group)
        # Where all viewpoints are known, each pair has been judged by them: nothing is left to say.
        is_told = all(scans[scan].viewpoint is not None for scan in group)
        if is_told or not 3 <= len(group) <= MOST_SCANS:
            groups.append(members)
            continue
        eyes, parts = Eyes(scans, members, length), [members]
        for _ in range(_ROUNDS):
            judged = judge_group(eyes, group, poses[members], edges, config)
            if judged is None:
                break
            poses[members] = judged.T_group_scan
            together[np.ix_(members, members)] = judged.together
            parts = _parts(members, together)
            if not judged.is_moved:
                break
            moved |= {*members}
        changed |= len(parts) > 1 or not moved.isdisjoint(members)
        groups += parts
    for part in groups:
        poses[part] = invert(poses[part[0]]) @ poses[part]
    result = placement_at(edges, groups, poses, config) if changed else placement
    probability = result.probability.copy()
    for group in result.groups:
        for scan in group if len(group) > 1 else ():
            sure = float(np.mean([together[scan, other] for other in group if other != scan]))
            probability[scan] = sure if scan in moved else min(probability[scan], sure)
    return replace(result, probability=probability), changed


def _parts(members: Sequence[int], together: np.ndarray) -> list[list[int]]:
    """The scans that chains of sure pairs connect."""
    parts: list[list[int]] = []
    for scan in members:
        joined = [part for part in parts if together[scan, part].max() >= _TOGETHER]
        parts = [part for part in parts if part not in joined]
        parts.append(sorted([scan, *(other for part in joined for other in part)]))
    return sorted(parts)
