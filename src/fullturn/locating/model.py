"""A model prepared once, to be found in many scenes."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import trimesh
from jaxtyping import Bool, Float, Int
from torch import Tensor

from fullturn.data.camera import bounding_ball
from fullturn.errors import InputError
from fullturn.geometry.diameter import diameter
from fullturn.geometry.normals import estimate_normals
from fullturn.geometry.sampling import local_area, point_spacing, voxel_sample
from fullturn.locating.describe import describe, descriptor_notes
from fullturn.locating.source import load_model
from fullturn.locating.views import View, views_of_cloud, views_of_mesh
from fullturn.threads import torch_threads


@dataclass(frozen=True)
class ModelConfig:
    """How finely a model is prepared. Points of a view: the median over all views."""

    views: int = 42
    fine_points: int = 1200  # of a view, for verification
    level_points: tuple[int, ...] = (600, 150)  # of a view, for descriptors; few: sparse scenes
    least_thickness: float = 1e-3  # of the diameter; a thinner model has no outside


@dataclass(frozen=True, eq=False)
class DescribedViews:
    """All views at one point spacing, their points one after the other."""

    points: Float[Tensor, "b 3"]
    normals: Float[Tensor, "b 3"]  # away from the mean of their view, as a scan's are
    descriptors: Float[Tensor, "b c"]
    counts: Int[Tensor, " v"]  # points of each view
    voxel: float
    spacing: float


@dataclass(frozen=True, eq=False)
class PreparedModel:
    """The outside of a model and its views, described. Lengths: (x − center) / radius.

    Saved by `save`, loaded by `fullturn.locating.store.load_prepared`, or by its path in `locate`.
    """

    name: str
    source: str  # hash of what it was prepared from
    center: Float[Tensor, "3"]  # float64, in the model's unit and frame
    radius: float  # of a ball around all of it, in the model's unit
    diameter: float  # largest distance of two of its points, in the model's unit
    surface: Float[Tensor, "m 3"]
    normals: Float[Tensor, "m 3"]  # to the outside
    area: Float[Tensor, " m"]
    directions: Float[Tensor, "v 3"]  # from the middle to the eyes
    seen: Bool[Tensor, "v m"]  # which of the surface each eye sees
    fine_voxel: float
    spacing: float  # of the surface
    levels: tuple[DescribedViews, ...]  # from the finest to the coarsest
    config: ModelConfig
    notes: tuple[str, ...] = ()

    def points(self) -> Float[np.ndarray, "m 3"]:
        """The surface in the model's own unit and frame, float64."""
        points = self.surface.double() * self.radius + self.center
        return points.numpy(force=True)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the prepared model to a file (.safetensors); `locate` takes its path as a model.

        Raises:
            WriteError: another suffix, or the place cannot be written.
        """
        from fullturn.locating.store import save_model

        save_model(path, self)


@torch_threads(1)
def prepare(model: Any, *, config: ModelConfig = ModelConfig()) -> PreparedModel:
    """Everything about a model that does not depend on the scene; takes a few seconds.

    `model` is a mesh or a complete cloud: a file path, an (N, 3) array, list or tensor, or an
    object with `.points` or with `.vertices` and `.faces`. Its unit has to be that of the scenes.

    Raises:
        InputError: something else, too few points, or a flat model.
        ReadError: a file that cannot be read.
    """
    source = load_model(model)
    center, radius = bounding_ball(source.points)
    points = (source.points - center) / radius
    across = diameter(points)
    thickness = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1]
    if thickness / np.sqrt(len(points)) < config.least_thickness * across:
        raise InputError(
            f"{source.name}: expected a model with an outside, all of it lies in one plane; "
            "give it a thickness, or use register for flat clouds"
        )
    if source.faces is not None:
        mesh = trimesh.Trimesh(points, source.faces, process=False)
        views = views_of_mesh(mesh, count=config.views)
    else:
        views = views_of_cloud(points, count=config.views)
    if len(views) < 3:
        raise InputError(
            f"{source.name}: expected a model that can be seen from all around, found "
            f"{len(views)} of {config.views} views with enough of it; give more points or a mesh"
        )
    clouds = [torch.from_numpy(view.points) for view in views]
    fine_voxel = _voxel_for(clouds, config.fine_points)
    surface, normals, seen = _outside(views, fine_voxel)
    levels = tuple(_described(clouds, count, fine_voxel) for count in config.level_points)
    return PreparedModel(
        name=source.name,
        source=source.key,
        center=torch.from_numpy(center),
        radius=radius,
        diameter=across * radius,
        surface=surface.float(),
        normals=normals.float(),
        area=local_area(surface).float(),
        directions=torch.from_numpy(np.stack([view.direction for view in views])).float(),
        seen=seen,
        fine_voxel=fine_voxel,
        spacing=_spacing([voxel_sample(cloud, fine_voxel)[0] for cloud in clouds]),
        levels=levels,
        config=config,
        notes=(*source.notes, *descriptor_notes()),
    )


def _voxel_for(clouds: list[Tensor], count: int) -> float:
    """The voxel size that leaves about `count` points of the median cloud."""
    some = clouds[:: max(1, len(clouds) // 9)]
    size = 1.0 / np.sqrt(count)
    for _ in range(8):
        found = float(np.median([len(voxel_sample(cloud, size)[0]) for cloud in some]))
        if abs(found / count - 1) < 0.05:
            break
        # Surfaces: the number of voxels falls with the square of their size.
        size *= float(np.sqrt(found / count))
    return float(size)


def _described(clouds: list[Tensor], count: int, fine_voxel: float) -> DescribedViews:
    voxel = _voxel_for(clouds, count)
    thinned = [voxel_sample(cloud, voxel)[0] for cloud in clouds]
    spacing = _spacing(thinned)
    fine = min(fine_voxel * (voxel / fine_voxel) ** 0.5, voxel)
    views = [describe(cloud, voxel=voxel, fine_voxel=fine, spacing=spacing) for cloud in clouds]
    return DescribedViews(
        points=torch.cat([view.points for view in views]),
        normals=torch.cat([view.normals for view in views]),
        descriptors=torch.cat([view.descriptors for view in views]),
        counts=torch.tensor([len(view.points) for view in views]),
        voxel=voxel,
        spacing=spacing,
    )


def _spacing(clouds: list[Tensor]) -> float:
    return float(np.median([point_spacing(cloud) for cloud in clouds if len(cloud) > 1]))


def _outside(views: list[View], voxel: float) -> tuple[Tensor, Tensor, Tensor]:
    """Points of the surface, their normals to the outside, and which view sees them.

    One point a voxel and side: a sheet that is seen from both has two.
    """
    points, normals, view_of = [], [], []
    for number, view in enumerate(views):
        cloud = torch.from_numpy(view.points)
        points.append(cloud)
        normals.append(
            estimate_normals(
                cloud, k=12, orientation="viewpoint", viewpoint=torch.from_numpy(view.eye)
            )
        )
        view_of.append(torch.full((len(cloud),), number))
    at, normal, view_number = torch.cat(points), torch.cat(normals), torch.cat(view_of)
    _, voxel_of = torch.unique((at / voxel).floor().long(), dim=0, return_inverse=True)
    first = torch.full((int(voxel_of.max()) + 1,), len(at))
    first.scatter_reduce_(0, voxel_of, torch.arange(len(at)), "amin")
    other = (normal * normal[first[voxel_of]]).sum(1) < 0
    _, group = torch.unique(2 * voxel_of + other, return_inverse=True)
    groups = int(group.max()) + 1
    count = torch.bincount(group, minlength=groups).to(at)
    surface = at.new_zeros(groups, 3).index_add_(0, group, at) / count[:, None]
    summed = at.new_zeros(groups, 3).index_add_(0, group, normal)
    seen = torch.zeros(len(views), groups, dtype=torch.bool)
    seen[view_number, group] = True
    return surface, torch.nn.functional.normalize(summed, dim=1), seen
