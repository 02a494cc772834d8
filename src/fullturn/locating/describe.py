"""A part of a surface at one point spacing, described as the default method describes a cloud."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.features.surface import surface_histogram
from fullturn.geometry.normals import estimate_normals
from fullturn.geometry.sampling import local_area, voxel_sample
from fullturn.nn.surface import load_surface_net
from fullturn.pose.search import NO_WEIGHTS

_NORMAL_NEIGHBORS = 20
_HISTOGRAM_RADIUS = 12.0  # point spacings, where the package has no descriptor weights


@dataclass(frozen=True, eq=False)
class Described:
    """Points of one spacing, in float32."""

    points: Float[Tensor, "n 3"]
    normals: Float[Tensor, "n 3"]  # away from the mean of the points
    area: Float[Tensor, " n"]  # that each point stands for, 1 on average
    descriptors: Float[Tensor, "n c"]  # of unit length


def descriptor_notes() -> tuple[str, ...]:
    """What a user should know of the descriptors."""
    return () if load_surface_net() is not None else (NO_WEIGHTS,)


def describe(
    points: Float[Tensor, "n 3"], *, voxel: float, fine_voxel: float, spacing: float
) -> Described:
    """The means of voxels with their normals, from finer voxels, and their descriptors.

    `spacing` is what lengths are counted in: the same for all that is to be compared.
    """
    fine, _ = voxel_sample(points, fine_voxel)
    thin, _ = voxel_sample(fine, voxel)
    normals = estimate_normals(
        fine, k=min(_NORMAL_NEIGHBORS, len(fine)), queries=thin, orientation="centroid"
    ).normals.float()
    area = local_area(thin).float()
    thin = thin.float()
    network = load_surface_net()
    with torch.no_grad():
        if network is None:
            found = surface_histogram(thin, normals, area, radius=_HISTOGRAM_RADIUS * spacing)
        else:
            everyone = torch.arange(len(thin), device=thin.device)
            found = network.to(thin.device)(thin, normals, area, everyone, spacing=spacing)
    return Described(thin, normals, area, found)
