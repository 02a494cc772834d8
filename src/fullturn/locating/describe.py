"""A part of a surface at one point spacing, described as the default method describes a cloud."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry.cloud import Cloud
from fullturn.geometry.sampling import voxel_sample
from fullturn.nn.surface import load_surface_net
from fullturn.pose.levels import make_level
from fullturn.pose.search import NO_WEIGHTS
from fullturn.pose.similarity import histograms, network_descriptors


@dataclass(frozen=True, eq=False)
class Described:
    """Points of one spacing, in float32."""

    points: Float[Tensor, "n 3"]
    normals: Float[Tensor, "n 3"]  # away from the mean of the points
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
    level = make_level(thin, Cloud(fine))
    everyone = torch.arange(len(thin), device=thin.device)
    found = network_descriptors(level, everyone, spacing=spacing)
    if found is None:
        found = histograms(level, everyone, spacing=spacing)
    return Described(level.points, level.normals, found)
