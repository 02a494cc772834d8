"""The least-squares problem of iterative closest point, shared by every refinement."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def normal_equations(
    at: Float[Tensor, "*batch n 3"],
    difference: Float[Tensor, "*batch n 3"],
    normal: Float[Tensor, "*batch n 3"],
    weight: Float[Tensor, "*batch n"],
    *,
    point_share: float,
) -> tuple[Float[Tensor, "*batch 6 6"], Float[Tensor, "*batch 6"]]:
    """H = Σ w JᵀWJ and g = Σ w JᵀWr of a small motion (ω, v) of the points: x → x + ω × x + v.

    r is the `difference` between a point and its partner, J = [−[x]×, I], and
    W = (1 − p) n nᵀ + p I with p = `point_share`: 0 is point-to-plane, 1 is point-to-point, between
    them sliding along the surface costs p times what leaving it costs.
    """
    plane = torch.cat([torch.linalg.cross(at, normal, dim=-1), normal], -1)
    height = (difference * normal).sum(-1)
    weighted = plane * ((1 - point_share) * weight).unsqueeze(-1)
    H = weighted.mT @ plane
    g = (weighted.mT @ height.unsqueeze(-1)).squeeze(-1)
    # The isotropic part in closed form, without building J.
    w = (point_share * weight).unsqueeze(-1)
    eye = torch.eye(3, dtype=at.dtype, device=at.device)
    moment = (w * at).mT @ at
    trace = moment.diagonal(dim1=-2, dim2=-1).sum(-1)
    mean = skew((w * at).sum(-2))
    H[..., :3, :3] += trace[..., None, None] * eye - moment
    H[..., :3, 3:] += mean
    H[..., 3:, :3] += mean.mT
    H[..., 3:, 3:] += w.sum(-2).unsqueeze(-1) * eye
    g[..., :3] += (w * torch.linalg.cross(at, difference, dim=-1)).sum(-2)
    g[..., 3:] += (w * difference).sum(-2)
    return H, g


def gauss_newton_step(
    H: Float[Tensor, "*batch 6 6"], g: Float[Tensor, "*batch 6"], *, largest: float = 0.5
) -> Float[Tensor, "*batch 6"]:
    """−H⁻¹g, damped by a trace of H, no entry above `largest`; zero where nothing pulls."""
    size = H.diagonal(dim1=-2, dim2=-1).mean(-1)
    tiny = torch.finfo(H.dtype).eps
    damping = (1e3 * tiny * size + tiny)[..., None, None]
    eye = torch.eye(6, dtype=H.dtype, device=H.device)
    return -torch.linalg.solve(H + damping * eye, g.unsqueeze(-1)).squeeze(-1).clamp(
        -largest, largest
    )


def skew(v: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """[v]×, so that [v]× x = v × x."""
    x, y, z = v.unbind(-1)
    zero = torch.zeros_like(x)
    rows = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1)
    return rows.view(*v.shape[:-1], 3, 3)
