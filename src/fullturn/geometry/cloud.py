"""One point cloud as the methods see it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from fullturn.geometry.neighbors import NeighborIndex, knn
from fullturn.geometry.normals import estimate_normals
from fullturn.geometry.sampling import point_spacing

_SAMPLE_LIMIT = 10_000
_NEIGHBORS, _MOST_COPIES = 20, 5


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points in a frame centered on their own mean, and where the sensor stood, if known.

    Both clouds of a pair are divided by one common length, so lengths inside a method are
    *normalized*: 1 is about the radius of the larger cloud.
    """

    points: Float[Tensor, "n 3"]  # float64, finite
    viewpoint: Float[Tensor, "3"] | None = None

    @cached_property
    def index(self) -> NeighborIndex:
        """Nearest neighbors at full resolution; built once, on first use."""
        return NeighborIndex(self.points)

    @cached_property
    def spacing(self) -> float:
        """Median distance between neighboring points."""
        return point_spacing(self.points, index=self.index)

    @cached_property
    def sample(self) -> Float[Tensor, "s 3"]:
        """At most 10,000 of the points, evenly over the rows: where noise and overlap are taken."""
        return self.points[:: -(-len(self.points) // _SAMPLE_LIMIT)]

    @cached_property
    def around(self) -> tuple[Int[Tensor, "s k"], Float[Tensor, "s k"]]:
        """Index and distance of the sample's 20 nearest points, themselves among them.

        Where most of them are copies of one point, which show no surface, of points apart.
        """
        found = self.index.knn(self.sample, min(_NEIGHBORS, len(self.points)))
        if not bool((found[1] == 0).sum(1).median() > _MOST_COPIES):
            return found
        _, first = np.unique(self.points.numpy(force=True), axis=0, return_index=True)
        if len(first) < _NEIGHBORS:
            return found
        row = torch.from_numpy(first).to(self.points.device)
        index, distance = knn(self.sample, self.points[row], _NEIGHBORS)
        return row[index], distance

    @cached_property
    def sample_normals(self) -> Float[Tensor, "s 3"]:
        """Unit normals at the sample, of either sign, from neighbors at full resolution."""
        return estimate_normals(
            self.points, queries=self.sample, neighbor_index=self.around[0], orientation="none"
        )
