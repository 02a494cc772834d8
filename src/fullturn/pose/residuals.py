"""The least-squares problem of iterative closest point, shared by every refinement."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry import rigid

_Equations = tuple[Float[Tensor, "*batch 6 6"], Float[Tensor, "*batch 6"]]


def normal_equations(
    at: Float[Tensor, "*batch n 3"],
    difference: Float[Tensor, "*batch n 3"],
    normal: Float[Tensor, "*batch n 3"],
    weight: Float[Tensor, "*batch n"],
    *,
    point_share: float = 0.0,
) -> _Equations:
    """H = Σ w JᵀWJ and g = Σ w JᵀWr of a small motion (ω, v) of the points: x → x + ω × x + v.

    r is the `difference` between a point and its partner, J = [−[x]×, I], and
    W = (1 − p) n nᵀ + p I with p = `point_share`: 0 is point-to-plane, 1 is point-to-point, between
    them sliding along the surface costs p times what leaving it costs.
    """
    x, d, n = (rows.movedim(-1, 0).contiguous() for rows in (at, difference, normal))
    H, g = plane_equations(x, d, n, weight)
    if point_share == 0:
        return H, g
    H_point, g_point = _point_part(at, difference, weight)
    return (
        (1 - point_share) * H + point_share * H_point,
        (1 - point_share) * g + point_share * g_point,
    )


def plane_equations(
    at: Float[Tensor, "3 *batch n"],
    difference: Float[Tensor, "3 *batch n"],
    normal: Float[Tensor, "3 *batch n"],
    weight: Float[Tensor, "*batch n"],
) -> _Equations:
    """`normal_equations` of heights above tangent planes, r = n·difference, J = [x × n, n].

    Coordinates come first. H and g are blocks of one product.
    """
    x, y, z = at
    n, d = normal, difference
    rows = at.new_empty(7, *at.shape[1:])
    torch.mul(y, n[2], out=rows[0]).addcmul_(z, n[1], value=-1)
    torch.mul(z, n[0], out=rows[1]).addcmul_(x, n[2], value=-1)
    torch.mul(x, n[1], out=rows[2]).addcmul_(y, n[0], value=-1)
    rows[3:6] = n
    torch.mul(d[0], n[0], out=rows[6]).addcmul_(d[1], n[1]).addcmul_(d[2], n[2])
    product = (rows * weight).movedim(0, -2) @ rows.movedim(0, -1)
    return product[..., :6, :6], product[..., :6, 6]


def _point_part(at: Tensor, difference: Tensor, weight: Tensor) -> _Equations:
    """J = [−[x]×, I], in closed form from the weighted moments."""
    w = weight.unsqueeze(-1)
    eye = torch.eye(3, dtype=at.dtype, device=at.device)
    moment = (w * at).mT @ at
    trace = moment.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    mean = rigid.skew((w * at).sum(-2))
    total = w.sum(-2).unsqueeze(-1) * eye
    upper = torch.cat([trace * eye - moment, mean], -1)
    H = torch.cat([upper, torch.cat([mean.mT, total], -1)], -2)
    turn = (w * torch.linalg.cross(at, difference, dim=-1)).sum(-2)
    return H, torch.cat([turn, (w * difference).sum(-2)], -1)


def gauss_newton_step(
    H: Float[Tensor, "*batch 6 6"],
    g: Float[Tensor, "*batch 6"],
    *,
    damping: float,
    largest: float = 0.5,
) -> Float[Tensor, "*batch 6"]:
    """−H⁻¹g, damped by `damping` times the mean diagonal of H, no entry above `largest`.

    Zero where nothing pulls. Damping holds back what the residuals leave free.
    """
    size = H.diagonal(dim1=-2, dim2=-1).mean(-1)[..., None, None]
    eye = torch.eye(6, dtype=H.dtype, device=H.device)
    damped = H + (damping * size + torch.finfo(H.dtype).tiny ** 0.5) * eye
    return -torch.linalg.solve(damped, g.unsqueeze(-1)).squeeze(-1).clamp(-largest, largest)
