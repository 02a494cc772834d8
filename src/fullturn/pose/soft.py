"""The pose that a soft matching stands for (G6–G8), with gradients that stay finite."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from fullturn.geometry import rigid
from fullturn.pose.kabsch import nearest_rotation


def soft_pose(
    matching: Float[Tensor, "b n m"],
    source: Float[Tensor, "b n 3"],
    target: Float[Tensor, "b m 3"],
) -> Float[Tensor, "b 4 4"]:
    """The rigid `T_target_source` that best carries source points onto their soft targets.

    With confidence c_i = Σ_j m*_ij (G6) and soft target y(m*(x_i)) = Σ_j m*_ij y_j / c_i (G7), it
    minimizes Σ_i c_i |T x_i − y(m*(x_i))|² (G8, Kabsch). Only c_i y(m*(x_i)) = Σ_j m*_ij y_j enters
    its solution, so nothing is divided by a confidence, however small. The scale of the matching
    is of no matter; padding has to be 0 in it.

    Where the matching leaves the rotation open (everything at one point, all of it zero, or every
    row alike but for rounding), one minimizer is returned and the rotation's gradient is zero.
    """
    dtype = torch.finfo(matching.dtype)
    confidence = matching.sum(-1, keepdim=True)  # G6
    total = confidence.sum(-2, keepdim=True)
    # Below the bound its reciprocal, squared in places, would leave the range of the dtype.
    total = torch.where(total > dtype.tiny**0.5, total, torch.ones_like(total))
    source_share = confidence / total
    source_mean = (source_share * source).sum(-2, keepdim=True)
    source_centered = source - source_mean
    # For each target point, what Σ_i m*_ij (x_i − mean) and Σ_i m*_ij are of the total.
    # (In this order the product is many times faster than that of the transposes.)
    moments = ((functional.pad(source_centered, (0, 1), value=1.0) / total).mT @ matching).mT
    target_share = moments[..., 3:]
    target_mean = (target_share * target).sum(-2, keepdim=True)
    target_centered = target - target_mean
    covariance = target_centered.mT @ moments[..., :3]  # G7, G8
    with torch.no_grad():
        source_spread = _spread(source, source_centered, source_share)
        target_spread = _spread(target, target_centered, target_share)
        # By Cauchy and Schwarz no entry of the covariance is larger.
        scale = (source_spread * target_spread)[:, None, None]
        known = covariance.abs().amax((-2, -1), keepdim=True) > 8.0 * dtype.eps * scale
        known &= scale > 0
    scaled = covariance / torch.where(known, scale, torch.ones_like(scale))
    rotation = nearest_rotation(torch.where(known, scaled, torch.zeros_like(scaled)))
    translation = target_mean.mT - rotation @ source_mean.mT
    return rigid.make(rotation, translation.squeeze(-1))


def _spread(points: Tensor, centered: Tensor, share: Tensor) -> Tensor:
    """Root of the weighted mean square distance from the mean; 0 where it is rounding alone."""
    spread = (share * centered.square()).sum((-2, -1)).sqrt()
    used = points.abs() * (share > 0)
    rounding = 8.0 * torch.finfo(points.dtype).eps * used.amax((-2, -1))
    return torch.where(spread > rounding, spread, torch.zeros_like(spread))
