"""One cloud of many: where scans cover the same surface, their points become one."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

# Two means of neighboring cells nearer than this share of a cell are one place of the surface.
_SAME_PLACE = 0.5


@dataclass(frozen=True, eq=False)
class MergedCloud:
    """A group's scans as one cloud, in the group's frame."""

    points: np.ndarray  # (n, 3)
    count: np.ndarray  # (n,) int64, how many points of the scans each is the mean of


def merge_clouds(clouds: Iterable[np.ndarray], cell: float) -> MergedCloud:
    """The mean of the points in each cell of a grid; means that nearly coincide become one.

    The clouds (n, 3) are taken one at a time, so no more than one of them and the merged cloud are
    in memory.
    """
    keys = np.zeros((0, 3))  # not integers, which end before the coordinates of strays do
    total, count = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    for cloud in clouds:
        cells = np.floor(cloud / cell)
        keys, place = np.unique(np.concatenate([keys, cells]), axis=0, return_inverse=True)
        place = place.ravel()
        weights = np.concatenate([count, np.ones(len(cloud), dtype=np.int64)])
        sums = np.concatenate([total, cloud])
        total = np.stack([np.bincount(place, sums[:, k], len(keys)) for k in range(3)], axis=1)
        count = np.bincount(place, weights, len(keys)).astype(np.int64)
    return _joined(total, count, _SAME_PLACE * cell)


def _joined(total: np.ndarray, count: np.ndarray, within: float) -> MergedCloud:
    """Join each two means that are each other's nearest and lie within a distance."""
    means = total / count[:, None]
    if len(means) > 1:
        distance, nearest = cKDTree(means).query(means, k=2, distance_upper_bound=within)
        other = nearest[:, 1]
        own = np.arange(len(means))
        found = np.isfinite(distance[:, 1])
        first = own[found][other[found] > own[found]]
        first = first[other[other[first]] == first]
        second = other[first]
        total[first] += total[second]
        count[first] += count[second]
        keep = np.ones(len(means), dtype=bool)
        keep[second] = False
        total, count = total[keep], count[keep]
    return MergedCloud(total / count[:, None], count)
