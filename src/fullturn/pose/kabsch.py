"""The best rigid motion between weighted point pairs, with gradients that stay finite."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from fullturn.geometry import rigid


def weighted_kabsch(
    source: Float[Tensor, "*batch n 3"],
    target: Float[Tensor, "*batch n 3"],
    weights: Float[Tensor, "*batch n"],
) -> Float[Tensor, "*batch 4 4"]:
    """The rigid `T_target_source` that minimizes Σ wᵢ |T sourceᵢ − targetᵢ|².

    R is the rotation next to A = Σ wᵢ (targetᵢ − target mean)(sourceᵢ − source mean)ᵀ (Kabsch
    1976; Umeyama 1991), always with determinant +1. Where the pairs leave R open (collinear,
    coincident, all weights zero), one minimizer is returned. Gradients of all three arguments
    are finite everywhere: a direction that the pairs leave open gets gradient zero.

    >>> points = torch.eye(3, dtype=torch.float64)
    >>> weighted_kabsch(points, points + 2.0, torch.ones(3).double())[:3, 3].round()
    tensor([2., 2., 2.], dtype=torch.float64)
    """
    total = weights.sum(-1, keepdim=True)
    # Next to nothing counts as nothing: its gradients would be infinite.
    some = total > torch.finfo(source.dtype).tiny ** 0.5
    share = (weights / torch.where(some, total, torch.ones_like(total))).unsqueeze(-1)
    source_mean = (share * source).sum(-2, keepdim=True)
    target_mean = (share * target).sum(-2, keepdim=True)
    source_centered, target_centered = source - source_mean, target - target_mean
    covariance = (share * target_centered).mT @ source_centered
    # What rounding makes of coincident points is no direction.
    eps = torch.finfo(source.dtype).eps
    rounding = (8.0 * eps) ** 2 * source.abs().amax((-2, -1)) * target.abs().amax((-2, -1))
    size = covariance.detach().abs().amax((-2, -1))
    known = (size > rounding.detach())[..., None, None]
    scale = torch.where(known, size[..., None, None], torch.ones_like(covariance))
    scaled = torch.where(known, covariance / scale, torch.zeros_like(covariance))
    rotation = nearest_rotation(scaled)
    translation = target_mean.mT - rotation @ source_mean.mT
    return rigid.make(rotation, translation.squeeze(-1))


def nearest_rotation(matrix: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 3 3"]:
    """The rotation (determinant +1) that is nearest to a 3×3 matrix in Frobenius norm."""
    rotation: Tensor = _NearestRotation.apply(matrix)
    return rotation


def nearest_motion(T_a_b: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 4 4"]:
    """The motion without the rounding of many products: its rotation is one to the last digit."""
    return rigid.make(nearest_rotation(T_a_b[..., :3, :3]), T_a_b[..., :3, 3])


class _NearestRotation(torch.autograd.Function):
    """R = U diag(1, 1, det UVᵀ) Vᵀ, and its derivative in closed form.

    With A = R P, P = V diag(p) Vᵀ and Ω = Rᵀ dR skew, the skew part of Rᵀ dA = Ω P + dP gives
    (VᵀΩV)ᵢⱼ = (Vᵀ(Rᵀ dA − dAᵀ R)V)ᵢⱼ / (pᵢ + pⱼ). Unlike the derivative of the SVD itself, it
    divides by sums: repeated singular values do no harm, only an open rotation does.
    """

    @staticmethod
    def forward(ctx: Any, matrix: Tensor) -> Tensor:
        left, values, right = torch.linalg.svd(matrix)
        sign = torch.sign(torch.linalg.det(left) * torch.linalg.det(right))
        flip = torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign], -1)
        rotation = (left * flip.unsqueeze(-2)) @ right
        ctx.save_for_backward(rotation, values * flip, right.mT)
        return rotation

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> Tensor:
        rotation, stretch, basis = ctx.saved_tensors
        sums = stretch.unsqueeze(-1) + stretch.unsqueeze(-2)
        open_below = 64.0 * torch.finfo(grad.dtype).eps * stretch[..., :1, None]
        shares = torch.where(sums > open_below, 1.0 / sums, torch.zeros_like(sums))
        spread = basis.mT @ rotation.mT @ grad @ basis * shares
        return rotation @ basis @ (spread - spread.mT) @ basis.mT
