"""How much of two scans shows the same part of an object."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree


def scan_overlap(first: Float[np.ndarray, "n 3"], second: Float[np.ndarray, "m 3"]) -> float:
    """The smaller of the two shares of points that have a partner in the other scan.

    A partner lies within twice the median point spacing of the scan that it is in. Both scans are
    in one frame.
    """
    shares = []
    for points, others in ((first, second), (second, first)):
        tree = cKDTree(others)
        spacing = np.median(tree.query(others, k=2)[0][:, 1])
        shares.append(np.mean(tree.query(points, distance_upper_bound=2.0 * spacing)[0] < np.inf))
    return float(min(shares))
