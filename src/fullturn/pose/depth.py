"""Depth images: where points lie before an eye, and the nearest of them in each pixel."""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

NEAREST = 1e-3  # least depth that counts as before the eye


def sideways(forward: Float[Tensor, "*v 3"]) -> Float[Tensor, "*v 3"]:
    """A unit vector at right angles to each direction."""
    axes = torch.eye(3, dtype=forward.dtype, device=forward.device)
    right = torch.linalg.cross(forward, axes[forward.abs().argmin(-1)])
    return right / right.norm(dim=-1, keepdim=True).clamp_min(1e-12)


def project(
    points: Float[Tensor, "*batch n 3"], eye: Float[Tensor, "*v 3"], frame: Float[Tensor, "*v 3 3"]
) -> tuple[Float[Tensor, "*all n 2"], Float[Tensor, "*all n"]]:
    """Tangents of the angles off the middle of the image, and depths.

    The columns of `frame` are the axes of the image and the direction that the eye looks in.
    """
    local = (points - eye.unsqueeze(-2)) @ frame
    depth = local[..., 2]
    return local[..., :2] / depth.clamp_min(NEAREST).unsqueeze(-1), depth


def pixel_of(
    image: Float[Tensor, "*batch n 2"],
    inside: Bool[Tensor, "*batch n"],
    *,
    half: float | Tensor,
    width: float | Tensor,
    side: int,
) -> Int[Tensor, "*batch n"]:
    """The number of each point's pixel in a square image, from −`half` to `half`; 0 outside."""
    x, y = ((image + half) / width).clamp(0, side - 1).long().unbind(-1)
    return (x * side + y).masked_fill(~inside, 0)


def nearest_depth(
    pixel: Int[Tensor, "v n"],
    depth: Float[Tensor, "v n"],
    counted: Bool[Tensor, "v n"],
    *,
    side: int,
) -> Float[Tensor, "v side side"]:
    """The least depth of the counted points in each pixel, infinite where there are none."""
    image = depth.new_full((len(depth), side**2), math.inf)
    image.scatter_reduce_(1, pixel, depth.masked_fill(~counted, math.inf), "amin")
    return image.view(-1, side, side)


def widened(image: Float[Tensor, "v s s"]) -> Float[Tensor, "v s s"]:
    """The largest value of each pixel and the eight around it."""
    return torch.nn.functional.max_pool2d(image[:, None], 3, 1, 1)[:, 0]
