"""The default method's descriptor: sign-free pair angles in shells of distance."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

# Rows of the pair matrices worked on at once: their blocks then stay in the processor's cache.
_ROWS_AT_ONCE = 32


def surface_histogram(
    points: Float[Tensor, "n 3"],
    normals: Float[Tensor, "n 3"],
    area: Float[Tensor, " n"],
    *,
    radius: float,
    shells: int = 5,
    bins: int = 5,
) -> Float[Tensor, "n c"]:
    """How the surface around each point is bent, as histograms that no rigid motion changes.

    For a point i and each point j with 0 < |d| < `radius`, d = pⱼ − pᵢ, the three numbers
    |cos ∠(nᵢ, d)|, |cos ∠(nⱼ, d)|, |cos ∠(nᵢ, nⱼ)| are counted in `bins` bins for each of `shells`
    shells of |d|/radius. Membership is linear between bin centers, in distance and in angle, so
    noise moves counts smoothly, and each point j counts with the `area` that it stands for, so that
    dense parts don't drown the others. The signs of the normals never enter. Rows have unit length:
    square roots of shares (Hellinger), so that a dot product compares two of them.

    `radius` is in the unit of the points; the caller gives it as a multiple of their spacing, which
    makes the result independent of scale. Cost: n².
    """
    center = points.mean(0)
    points = points - center
    distance = torch.cdist(points, points, compute_mode="donot_use_mm_for_euclid_dist")
    per_length = distance.clamp_min(1e-12).reciprocal()
    own = normals @ points.T
    own -= (normals * points).sum(-1, keepdim=True)
    own = own.mul_(per_length).abs_()
    cosines = [own, own.T.contiguous(), (normals @ normals.T).abs_()]
    distance /= radius
    n = len(points)
    counts = points.new_empty(n, shells, 3 * bins)
    for first in range(0, n, _ROWS_AT_ONCE):
        rows = slice(first, first + _ROWS_AT_ONCE)
        near = distance[rows]
        in_shell = _membership(near, shells)
        in_shell *= area * ((near > 1e-6) & (near < 1)).unsqueeze(-2)
        in_bin = torch.cat([_membership(cosine[rows], bins) for cosine in cosines], -2)
        torch.bmm(in_shell, in_bin.mT, out=counts[rows])
    histogram = counts.view(n, -1)
    return (histogram / histogram.sum(-1, keepdim=True).clamp_min(1e-12)).sqrt_()


def _membership(values: Float[Tensor, "n m"], bins: int) -> Float[Tensor, "n bins m"]:
    """Share of each value in [0, 1] in each of `bins` bins, linear between bin centers."""
    position = (values * bins - 0.5).clamp_(0, bins - 1)
    centers = torch.arange(bins, dtype=values.dtype, device=values.device)[:, None]
    return (position.unsqueeze(-2) - centers).abs_().neg_().add_(1).clamp_min_(0)
