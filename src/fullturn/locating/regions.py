"""Parts of a scene in which the model may be."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree
from torch import Tensor

from fullturn.locating.planes import LINK, extent, pieces

_FEWEST = 20  # points of a region
_GAP = 0.25  # of the diameter: the widest gap that a sensor leaves between pieces of one object
_WHOLE = 1.3  # of the diameter: what reaches no farther may be the model alone
# What reaches farther than this, in diameters, is looked at through balls of this radius. No point
# is farther than the step from the middle of one, so that some ball holds the model nearly whole.
_WIDE, _BALL, _STEP = 2.0, 0.75, 0.5


def regions(
    points: Float[Tensor, "n 3"],
    candidates: Bool[Tensor, " n"],
    *,
    diameter: float,
    spacing: float,
    limit: int,
) -> list[Bool[Tensor, " n"]]:
    """At most `limit` sets of candidate points, the largest first.

    All candidates, where they reach no farther than the model might. Else pieces that hang
    together, and with each the pieces near it as long as all of them reach no farther. What hangs
    together and is far larger than the model comes in overlapping balls.
    """
    index = torch.nonzero(candidates)[:, 0]
    if len(index) < _FEWEST:
        return []
    at = points[index].numpy(force=True)
    piece_of = pieces(at, LINK * spacing)
    sizes = np.bincount(piece_of)
    # A few stray returns say nothing, and would make everything large.
    kept = np.flatnonzero(sizes >= max(4, 0.005 * len(at)))
    rows = [np.flatnonzero(piece_of == piece) for piece in kept[np.argsort(-sizes[kept])]]
    if not rows:
        return []
    everything = np.concatenate(rows)
    groups = [everything]
    if extent(torch.from_numpy(at[everything])) > _WHOLE * diameter:
        groups = _joined(at, rows, diameter)
    if any(extent(torch.from_numpy(at[group])) > _WIDE * diameter for group in groups):
        # Spread over all points, taken or not: what is far from a taken one stays as it was.
        middles = _spread(points.numpy(force=True), _STEP * diameter)
        groups = [ball for group in groups for ball in _balls(at, group, middles, diameter)]
    groups = sorted((g for g in groups if len(g) >= _FEWEST), key=len, reverse=True)[:limit]
    found = []
    for group in groups:
        mask = torch.zeros_like(candidates)
        mask[index[torch.from_numpy(group)]] = True
        found.append(mask)
    return found


def _balls(
    points: np.ndarray, group: np.ndarray, middles: np.ndarray, diameter: float
) -> list[np.ndarray]:
    """The group, where it isn't wide; else its points around each of the middles (m, 3)."""
    if extent(torch.from_numpy(points[group])) <= _WIDE * diameter:
        return [group]
    inside = cKDTree(points[group]).query_ball_point(middles, _BALL * diameter, return_sorted=True)
    return [group[rows] for rows in inside if rows]


def _spread(points: np.ndarray, step: float) -> np.ndarray:
    """Points (m, 3) that lie farther than `step` apart, and all others within it of one."""
    tree, covered, rows = cKDTree(points), np.zeros(len(points), dtype=bool), []
    for row in range(len(points)):
        if not covered[row]:
            rows.append(row)
            covered[tree.query_ball_point(points[row], step)] = True
    return np.asarray(points[rows])


def _joined(points: np.ndarray, parts: list[np.ndarray], diameter: float) -> list[np.ndarray]:
    """Pieces, the largest first, each with the smaller ones that are near and fit in with it."""
    free = list(range(len(parts)))
    groups = []
    while free:
        group = parts[free.pop(0)]
        tree = cKDTree(points[group])
        for other in list(free):
            gap = tree.query(points[parts[other]], distance_upper_bound=_GAP * diameter)[0].min()
            if not np.isfinite(gap):
                continue
            both = np.concatenate([group, parts[other]])
            if extent(torch.from_numpy(points[both])) <= diameter:
                group = both
                tree = cKDTree(points[group])
                free.remove(other)
        groups.append(group)
    return groups
