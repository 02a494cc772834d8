"""Where a cloud that a pose has moved meets the surface of the other."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from fullturn.geometry.neighbors import NeighborIndex, gather
from fullturn.pose.levels import Level
from fullturn.pose.visibility import DepthImages

NEAR = 1.5  # spacings within which two points are near
_NEIGHBORS = 12  # of a point, whose mean plane smooths it


@dataclass(frozen=True, eq=False)
class Surface:
    """A cloud prepared for verification."""

    points: Float[Tensor, "n 3"]
    normals: Float[Tensor, "n 3"]
    area: Float[Tensor, " n"]  # that each point stands for, 1 on average: all means count it
    smooth: Float[Tensor, "n 3"]  # moved along the normal into the mean plane of the neighbors
    rim: Float[Tensor, " n"]  # how far off the mean of the neighbors is, in their mean distance
    roughness: Float[Tensor, " n"]  # RMS height of the neighbors, in their mean distance
    index: NeighborIndex
    image: DepthImages | None  # what the one sensor saw, where its place is known

    @property
    def interior(self) -> Bool[Tensor, " n"]:
        """False on the rim of a partial cloud, where all neighbors lie on one side."""
        return self.rim < 0.35

    @property
    def facing(self) -> Float[Tensor, "3"]:
        """Mean of the normals, by area: of length 1 for a flat side, 0 for a complete cloud."""
        return (self.area @ self.normals) / self.area.sum()


def prepare_surface(
    level: Level,
    *,
    spacing: float,
    viewpoint: Float[Tensor, "3"] | None,
) -> Surface:
    """The cloud with its k-d tree, its smoothed points, its rim and its depth image."""
    points, normals = level.points, level.normals
    index = NeighborIndex(points)
    offset = gather(points, level.around[:, :_NEIGHBORS]) - points[:, None]
    height = (offset * normals[:, None]).sum(-1, keepdim=True)
    along = offset - height * normals[:, None]
    tiny = torch.finfo(points.dtype).tiny
    rim = along.mean(1).norm(dim=-1) / along.norm(dim=-1).mean(1).clamp_min(tiny)
    apart = offset.norm(dim=-1).mean(1).clamp_min(tiny)
    roughness = height[..., 0].square().mean(1).sqrt() / apart
    smooth = points + height.mean(1) * normals
    image = None
    if viewpoint is not None:
        image = DepthImages(points, viewpoint[None].to(points.dtype), spacing=spacing)
    return Surface(points, normals, level.area, smooth, rim, roughness, index, image)


@dataclass(frozen=True, eq=False)
class Contact:
    """All points of one surface, moved by each of k poses, and their nearest on the other one.

    Heights are above the partner's tangent plane, positive where its normal points.
    """

    own: Surface
    other: Surface
    points: Float[Tensor, "k n 3"]
    normals: Float[Tensor, "k n 3"]
    partner: Int[Tensor, "k n"]
    distance: Float[Tensor, "k n"]
    height: Float[Tensor, "k n"]
    smooth_height: Float[Tensor, "k n"]  # between smoothed points
    cosine: Float[Tensor, "k n"]  # of the two normals


def contacts(
    T_target_source: Float[Tensor, "k 4 4"], source: Surface, target: Surface
) -> tuple[Contact, Contact]:
    """The source on the target, in its frame, and the target on the source, in its own."""
    R, t = T_target_source[:, :3, :3], T_target_source[:, None, :3, 3]
    forward = _contact(
        source, target, source.points @ R.mT + t, source.smooth @ R.mT + t, source.normals @ R.mT
    )
    backward = _contact(
        target, source, (target.points - t) @ R, (target.smooth - t) @ R, target.normals @ R
    )
    return forward, backward


def _contact(
    own: Surface, other: Surface, points: Tensor, smooth: Tensor, normals: Tensor
) -> Contact:
    partner, distance = other.index.nearest(points.reshape(-1, 3))
    partner, distance = partner.view(points.shape[:2]), distance.view(points.shape[:2])
    partner_normals = other.normals[partner]
    return Contact(
        own,
        other,
        points,
        normals,
        partner,
        distance,
        ((points - other.points[partner]) * partner_normals).sum(-1),
        ((smooth - other.smooth[partner]) * partner_normals).sum(-1),
        (normals * partner_normals).sum(-1),
    )
