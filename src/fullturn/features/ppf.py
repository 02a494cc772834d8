"""Point pair features: how two oriented points lie to each other."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from fullturn.features.coordinates import delta_xyz
from fullturn.geometry.neighbors import fill_with_self, gather


def ppf(
    points: Float[Tensor, "*batch n 3"],
    normals: Float[Tensor, "*batch n 3"],
    neighbor_index: Int[Tensor, "*batch n k"],
    *,
    fold: bool = False,
) -> Float[Tensor, "*batch n k 4"]:
    """Angles ∠(n_i, d), ∠(n_j, d), ∠(n_i, n_j) in rad, and |d|, with d = p_j − p_i.

    Angles are atan2(|a×b|, a·b) in [0, π], exact for parallel vectors, where the arccosine is not.
    Coincident points (neighbor 0, the point itself) and missing neighbors (−1) have d = 0 and
    their first two angles 0. `fold` maps each angle to [0, π/2], so that the signs of the normals
    do not matter. Gradients are not defined at d = 0.

    >>> points = torch.tensor([[0.0, 0, 0], [2, 0, 0]])
    >>> normals = torch.tensor([[0.0, 0, 1], [1, 0, 0]])
    >>> ppf(points, normals, torch.tensor([[1], [0]]))[0]
    tensor([[1.5708, 0.0000, 1.5708, 2.0000]])
    """
    d = delta_xyz(points, neighbor_index)
    n_j = gather(normals, fill_with_self(neighbor_index))
    n_i = normals[..., None, :].expand_as(n_j)
    d, n_j, n_i = (vectors.movedim(-1, 0).contiguous() for vectors in (d, n_j, n_i))
    angles = [_angle(n_i, d, fold), _angle(n_j, d, fold), _angle(n_i, n_j, fold)]
    return torch.stack([*angles, d.square().sum(0).sqrt()], dim=-1)


def _angle(a: Tensor, b: Tensor, fold: bool) -> Tensor:
    """Angle between vectors of any length, components first."""
    cosine = (a * b).sum(0)
    sine = torch.linalg.cross(a, b, dim=0).square().sum(0).sqrt()
    return torch.atan2(sine, cosine.abs() if fold else cosine)
