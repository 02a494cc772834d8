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
    together, and with each the pieces near it as long as all of them reach no farther.
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
    groups = sorted((g for g in groups if len(g) >= _FEWEST), key=len, reverse=True)[:limit]
    found = []
    for group in groups:
        mask = torch.zeros_like(candidates)
        mask[index[torch.from_numpy(group)]] = True
        found.append(mask)
    return found


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
