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
_NEIGHBORS = 20
_FEW_COPIES = 0.05  # of the points: so many may have copies


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
        all_distinct = self.distinct is self.points
        return point_spacing(self.distinct, index=self.index if all_distinct else None)

    @cached_property
    def distinct(self) -> Float[Tensor, "d 3"]:
        """The points, each once; all as they are where next to none of them has a copy.

        Copies say nothing that one of them doesn't: neither of the surface nor of the noise.
        """
        if float((self._nearest[1][:, :2] == 0).all(1).double().mean()) <= _FEW_COPIES:
            return self.points
        _, first = np.unique(self.points.numpy(force=True), axis=0, return_index=True)
        return self.points[torch.from_numpy(np.sort(first)).to(self.points.device)]

    @cached_property
    def sample(self) -> Float[Tensor, "s 3"]:
        """At most 10,000 distinct points, evenly over the rows: noise and overlap are theirs."""
        return _sample(self.distinct)

    @cached_property
    def around(self) -> tuple[Int[Tensor, "s k"], Float[Tensor, "s k"]]:
        """Index among `distinct` and distance of the sample's 20 nearest, themselves among them."""
        if self.distinct is self.points:
            return self._nearest
        return knn(self.sample, self.distinct, min(_NEIGHBORS, len(self.distinct)))

    @cached_property
    def sample_normals(self) -> Float[Tensor, "s 3"]:
        """Unit normals at the sample, of either sign, from neighbors at full resolution."""
        return estimate_normals(
            self.distinct, queries=self.sample, neighbor_index=self.around[0], orientation="none"
        )

    @cached_property
    def _nearest(self) -> tuple[Int[Tensor, "s k"], Float[Tensor, "s k"]]:
        return self.index.knn(_sample(self.points), min(_NEIGHBORS, len(self.points)))


def _sample(points: Float[Tensor, "n 3"]) -> Float[Tensor, "s 3"]:
    return points[:: -(-len(points) // _SAMPLE_LIMIT)]
