"""Which pairs to register: all of few scans; of many, those that look most alike first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence, Set

import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.features.surface import surface_histogram
from fullturn.fusion.edges import Pair
from fullturn.fusion.scans import Scan
from fullturn.geometry.sampling import voxel_sample

ALL_PAIRS_UP_TO = 12  # scans
_FIRST_PARTNERS, _MORE_PARTNERS = 4, 3  # of each scan in the first round, and in each later one
_ENOUGH = 2  # trusted edges of each scan
PAIRS_PER_SCAN = 10
_CELL, _REACH = 0.08, 0.64  # of the common length: about 500 cells a scan
_ALIKE_SHARE = 0.33  # of the points: that much of two scans may well overlap


def likely_pairs(scans: Sequence[Scan], length: float) -> list[Pair]:
    """All pairs of scans, the most alike first, by the descriptors of their surfaces."""
    described = [_describe(scan, length) for scan in scans]
    alike = {
        (i, j): _similarity(described[i], described[j])
        for i in range(len(scans))
        for j in range(i + 1, len(scans))
    }
    return sorted(alike, key=lambda pair: (-alike[pair], pair))


def next_pairs(
    order: Sequence[Pair],
    done: Set[Pair],
    groups: Iterable[Sequence[int]],
    trusted: Iterable[Pair],
    *,
    scans: int,
) -> list[Pair]:
    """The pairs of the next round, at most `PAIRS_PER_SCAN` × scans in all; none: it is enough.

    The first round takes every scan's most likely partners. Later ones take more partners of scans
    outside the largest group, in other groups, and of scans that few edges hold.
    """
    if scans <= ALL_PAIRS_UP_TO:
        return [pair for pair in order if pair not in done]
    left = PAIRS_PER_SCAN * scans - len(done)
    group_of = {scan: number for number, group in enumerate(groups) for scan in group}
    held = Counter(scan for pair in trusted for scan in pair)
    want = dict.fromkeys(range(scans), _FIRST_PARTNERS)
    if done:
        want = {
            scan: _MORE_PARTNERS if group_of[scan] else max(0, _ENOUGH - held[scan])
            for scan in range(scans)
        }
    chosen: list[Pair] = []
    for pair in order:
        if len(chosen) >= left:
            break
        wanted = [scan for scan in pair if want[scan] > 0]
        # Two scans of one small group gain that group nothing.
        is_inner = bool(done) and group_of[pair[0]] == group_of[pair[1]] != 0
        if pair in done or not wanted or is_inner:
            continue
        chosen.append(pair)
        for scan in pair:
            want[scan] -= 1
    return chosen


def _describe(scan: Scan, length: float) -> Float[Tensor, "m c"]:
    points, kept = voxel_sample(scan.sample / length, _CELL)
    area = torch.ones_like(points[:, 0])
    return surface_histogram(points, scan.sample_normals[kept], area, radius=_REACH)


def _similarity(one: Float[Tensor, "m c"], other: Float[Tensor, "n c"]) -> float:
    """The mean similarity of the best matched third of each scan's points."""
    product = one @ other.T
    return sum(float(_best(product.amax(dim))) for dim in (0, 1)) / 2.0


def _best(similarity: Float[Tensor, " n"]) -> Float[Tensor, ""]:
    return similarity.topk(max(1, round(_ALIKE_SHARE * len(similarity)))).values.mean()
