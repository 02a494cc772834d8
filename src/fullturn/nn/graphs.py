"""The feature graphs of the three levels: who is whose neighbor, and how they lie to each other.

Everything here depends on the points alone: there is nothing to learn and no gradient.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from fullturn.features.fpfh import fpfh
from fullturn.features.ppf import ppf
from fullturn.features.rri import rri
from fullturn.geometry.neighbors import MISSING, fill_with_self, gather
from fullturn.geometry.normals import estimate_normals
from fullturn.nn.clouds import CloudBatch
from fullturn.nn.config import GMCNetConfig
from fullturn.nn.rows import Rows, farthest_rows, nearest_rows, pack

# The paper's neighborhood for normals, in the unit of the clouds.
_NORMAL_RADIUS = 0.1
_NORMAL_NEIGHBORS = 30
# Differences between neighbors are told in this length, a usual spacing: otherwise, beside
# angles and coordinates, a layer with small first weights hardly sees them. What can be learned is
# the same, as the first layer is linear.
SPACING = 0.05
# Coinciding points share the value almost alone.
_SMALLEST_DISTANCE = 1e-10
# Distances inside clusters that are held at once.
_CLUSTER_DISTANCES_AT_ONCE = 1 << 20


@dataclass(frozen=True, eq=False)
class Level:
    """A graph around each center; indices are rows of the level below (level 1: of all points)."""

    centers: Int[Tensor, " m"] | None  # None: every point
    neighbors: Int[Tensor, "m k"]  # nearest first: the center itself
    # ρ_ij = [p_j, (p_j − p_i)/SPACING, RI_ij], or RI_ij alone; of RI_ij, too, small differences are
    # in that unit: |d| of PPF; |q| − |p| in place of |q|, and θ, of RRI.
    relation: Float[Tensor, "m k c"]


@dataclass(frozen=True, eq=False)
class Interpolation:
    """How values of a coarse level go back to all points: by the three nearest coarse points."""

    rows: Int[Tensor, "t 3"]
    weights: Float[Tensor, "t 3"]  # ∝ 1/distance, summing to 1

    def __call__(self, values: Float[Tensor, "m c"]) -> Float[Tensor, "t c"]:
        return torch.nn.functional.embedding_bag(
            self.rows, values, mode="sum", per_sample_weights=self.weights.to(values)
        )


@dataclass(frozen=True, eq=False)
class Graphs:
    """All that the network knows of a batch of clouds."""

    ri: Float[Tensor, "t _"]  # of each point: RI of its neighbors, or its FPFH
    spatial: Float[Tensor, "t _"] | None  # [p_j, p_j − p_i] of the neighbors; None: RI only
    levels: tuple[Level, ...]  # 1, or 3 with the hierarchy
    back: tuple[Interpolation, ...]  # of levels 2 and 3


@torch.no_grad()
def build_graphs(clouds: CloudBatch, config: GMCNetConfig) -> Graphs:
    """The graphs of a batch.

    1. Neighbors of every point, as many as any user of the full cloud wants.
    2. Normals, where the features need them; then each cloud is centered on its own mean.
    3. Level 1 around every point; the nodes' own input.
    4. Level 2 around N/D1 farthest points, among all points.
    5. Level 3 around N/D2 farthest points of level 2, among the points of level 2.
    6. The way back from levels 2 and 3.
    """
    sizes = tuple(clouds.mask.sum(1).tolist())
    posed = Rows(pack(clouds.points, clouds.mask), sizes)
    centered = posed.centered()
    k1, k2, k3 = config.graph_neighbors
    k12 = max(k1, k2) if config.hgm else k1

    given = None if clouds.normals is None else pack(clouds.normals, clouds.mask)
    wants_normals = config.features != "rri" and given is None
    most = max(k12, _NORMAL_NEIGHBORS) if wants_normals else k12
    neighbors, distances = nearest_rows(centered, centered, most)
    normals = _normals(posed, neighbors, distances, config) if wants_normals else given

    full = _Surroundings(centered, normals, fill_with_self(neighbors[:, :k12]), config)
    first = full.level(None, k1)
    ri = first.relation[..., -config.ri_channels :].flatten(1)
    if config.features == "fpfh" and normals is not None:
        ri = _fpfh(centered, normals)
    spatial = None if config.rif_only else first.relation[..., :6].flatten(1)
    if not config.hgm:
        return Graphs(ri, spatial, (first,), ())

    counts2, counts3 = ([max(1, n // d) for n in sizes] for d in config.sampling)
    rows2 = farthest_rows(centered, counts2)
    coarse = Rows(centered.points[rows2], tuple(counts2))
    # Farthest points of farthest points: the first of those chosen before.
    rows3 = torch.cat(
        [
            torch.arange(start, start + count, device=rows2.device)
            for start, count in zip(coarse.starts, counts3, strict=True)
        ]
    )
    near, _ = nearest_rows(coarse, coarse, k3)
    coarse_normals = None if normals is None else normals[rows2]
    middle = _Surroundings(coarse, coarse_normals, fill_with_self(near), config)
    coarsest = Rows(coarse.points[rows3], tuple(counts3))
    return Graphs(
        ri,
        spatial,
        (first, full.level(rows2, k2), middle.level(rows3, k3)),
        (_interpolation(centered, coarse), _interpolation(centered, coarsest)),
    )


def rri_in_clusters(
    points: Float[Tensor, "n 3"], neighbors: Int[Tensor, "m k"]
) -> Float[Tensor, "m k 8"]:
    """RRI of each point of a cluster with the two other points of the cluster nearest to it.

    Seen from the origin, where the cloud's mean is to be. In a cluster of fewer than three points
    the point itself stands in for the missing ones.
    """
    rows = max(1, _CLUSTER_DISTANCES_AT_ONCE // neighbors.shape[1] ** 2)
    parts = []
    for some in neighbors.split(rows):
        cluster = gather(points, some)
        center = cluster.new_zeros(len(cluster), 3)
        parts.append(rri(cluster, _two_nearest(cluster), center=center).flatten(-2))
    return torch.cat(parts)


class _Surroundings:
    """Points with their neighbors among themselves, of which a level takes what it wants."""

    def __init__(
        self, rows: Rows, normals: Tensor | None, neighbors: Tensor, config: GMCNetConfig
    ) -> None:
        self.points = rows.points
        self.normals = normals
        self.neighbors = neighbors
        self.config = config

    @cached_property
    def pairs(self) -> Tensor | None:
        """PPF of all neighbors; None for RRI, which depends on the whole cluster."""
        if self.config.features == "rri" or self.normals is None:
            return None
        fold = self.config.orientation == "none"
        pairs = ppf(self.points, self.normals, self.neighbors, fold=fold)
        pairs[..., 3] /= SPACING
        return pairs

    def level(self, centers: Tensor | None, k: int) -> Level:
        """The graph around some of the points, with their k nearest."""
        at, neighbors = self.points, self.neighbors[:, :k]
        pairs = None if self.pairs is None else self.pairs[:, :k]
        if centers is not None:
            at, neighbors = at[centers], neighbors[centers]
            pairs = None if pairs is None else pairs[centers]
        relation = self._rri(neighbors) if pairs is None else pairs
        if not self.config.rif_only:
            absolute = gather(self.points, neighbors)
            apart = (absolute - at[:, None]) / SPACING
            relation = torch.cat([absolute, apart, relation], dim=-1)
        return Level(centers, neighbors, relation)

    def _rri(self, neighbors: Tensor) -> Tensor:
        features = rri_in_clusters(self.points, neighbors)
        p, q, theta = (features[..., channel::4] for channel in range(3))
        q -= p
        q /= SPACING
        theta /= SPACING
        return features


def _normals(posed: Rows, neighbors: Tensor, distances: Tensor, config: GMCNetConfig) -> Tensor:
    outside = distances[:, :_NORMAL_NEIGHBORS] > _NORMAL_RADIUS
    near = neighbors[:, :_NORMAL_NEIGHBORS].masked_fill(outside, MISSING)
    # One cloud at a time, so that no rounding depends on the company: where a neighborhood is a
    # line, rounding is all that decides.
    clouds = zip(posed.each(), near.split(posed.sizes), posed.starts, strict=True)
    return torch.cat(
        [
            estimate_normals(
                cloud,
                neighbor_index=torch.where(some < 0, MISSING, some - start),
                orientation=config.orientation,
            )
            for cloud, some, start in clouds
        ]
    )


def _fpfh(rows: Rows, normals: Tensor) -> Tensor:
    pairs = zip(rows.each(), normals.split(rows.sizes), strict=True)
    return torch.cat(
        [
            fpfh(cloud, some, radius=_NORMAL_RADIUS, max_neighbors=_NORMAL_NEIGHBORS)
            for cloud, some in pairs
        ]
    )


def _interpolation(points: Rows, coarse: Rows) -> Interpolation:
    rows, distances = nearest_rows(points, coarse, 3)
    weights = distances.clamp_min(_SMALLEST_DISTANCE).reciprocal()
    return Interpolation(rows.clamp_min(0), weights / weights.sum(-1, keepdim=True))


def _two_nearest(cluster: Float[Tensor, "m k 3"]) -> Int[Tensor, "m k 2"]:
    """Of each point the two others nearest to it, or the point itself where there are fewer."""
    m, k, _ = cluster.shape
    own = torch.arange(k, device=cluster.device).view(1, k, 1).expand(m, k, 1)
    distance = torch.cdist(cluster, cluster, compute_mode="donot_use_mm_for_euclid_dist")
    distance.diagonal(dim1=-2, dim2=-1).fill_(torch.inf)
    found = []
    for _ in range(min(2, k - 1)):
        nearest = distance.argmin(-1, keepdim=True)
        found.append(nearest)
        distance = distance.scatter_(-1, nearest, torch.inf)
    return torch.cat([*found, *[own] * (2 - len(found))], dim=-1)
