"""How far a cloud reaches."""

from __future__ import annotations

import contextlib

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import pdist

_MOST_ON_HULL = 4000  # points whose distances are all taken


def diameter(points: Float[np.ndarray, "n 3"]) -> float:
    """The largest distance of two points, which lie on the convex hull.

    Of more than 4,000 there, every second, third, … is asked.

    >>> diameter(np.array([[0.0, 0, 0], [1, 0, 0], [3, 4, 0]]))
    5.0
    """
    with contextlib.suppress(QhullError):  # flat: all points are on it
        points = points[ConvexHull(points).vertices]
    points = points[:: -(-len(points) // _MOST_ON_HULL)]
    return float(pdist(points).max())
