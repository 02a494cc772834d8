"""Generated surfaces with known normals, and small tools for the pose tests."""

from __future__ import annotations

from functools import cache

import numpy as np
import torch
from torch import Tensor

from fullturn.data.procedural import demo_object
from fullturn.data.surface import sample_faces
from fullturn.geometry import rigid
from fullturn.geometry.neighbors import knn
from fullturn.geometry.sampling import local_area
from fullturn.pose.levels import Level


@cache
def teapot(count: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Points and true normals (float64) of an object without symmetry, radius 1; do not modify."""
    mesh = demo_object()
    rng = np.random.default_rng(seed)
    points, face = sample_faces(mesh, count, rng)
    order = rng.permutation(count)
    normals = np.asarray(mesh.face_normals)[face]
    return torch.from_numpy(points[order]), torch.from_numpy(normals[order])


def level_of(points: Tensor, normals: Tensor) -> Level:
    """A level with the normals that it is given."""
    around, distance = knn(points, points, min(20, len(points)))
    return Level(points, normals, local_area(points, distance=distance), around)


def random_motions(
    count: int, *, seed: int = 0, angle_deg: float = 180.0, length: float = 0.3
) -> Tensor:
    """Rigid motions (count, 4, 4), float64: any axis, an angle up to `angle_deg`."""
    rng = np.random.default_rng(seed)
    axis = torch.from_numpy(rng.standard_normal((count, 3)))
    angle = torch.from_numpy(np.radians(rng.uniform(0.0, angle_deg, count)))
    R = rigid.rotation_from_axis_angle(axis, angle)
    return rigid.make(R, torch.from_numpy(rng.normal(size=(count, 3))) * length)


def perturbations(count: int, *, seed: int = 0, angle_deg: float, length: float) -> Tensor:
    """Small motions (count, 4, 4), float64, all of one angle and one length."""
    rng = np.random.default_rng(seed)
    directions = torch.from_numpy(rng.normal(size=(count, 2, 3)))
    directions = directions / directions.norm(dim=-1, keepdim=True)
    R = rigid.exp_so3(directions[:, 0] * np.radians(angle_deg))
    return rigid.make(R, directions[:, 1] * length)


def pose_error(T: Tensor, T_true: Tensor) -> tuple[Tensor, Tensor]:
    """Rotation errors (deg) and translation errors of (*batch, 4, 4) poses, in float64."""
    T, T_true = T.double(), T_true.double()
    angle = rigid.rotation_angle_rad(T_true[..., :3, :3].mT @ T[..., :3, :3])
    return angle.rad2deg(), (T[..., :3, 3] - T_true[..., :3, 3]).norm(dim=-1)


def rms_displacement(T: Tensor, T_other: Tensor, points: Tensor) -> float:
    """√(mean |T x − T' x|²) over the points."""
    apart = rigid.apply(T, points) - rigid.apply(T_other, points)
    return float(apart.square().sum(-1).mean().sqrt())
