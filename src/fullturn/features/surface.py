"""How the surface around a point is bent: histograms of pair angles in shells of distance."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from fullturn.geometry.step import unit_step

# Rows of the pair matrices worked on at once: their blocks then stay in the processor's cache.
_ROWS_AT_ONCE = 32


def surface_histogram(
    points: Float[Tensor, "n 3"],
    normals: Float[Tensor, "n 3"],
    area: Float[Tensor, " n"],
    *,
    radius: float,
    keypoints: Int[Tensor, " k"] | None = None,
    shells: int = 5,
    bins: int = 5,
) -> Float[Tensor, "k c"]:
    """Shares of the sign-free pair angles in shells of distance, which no rigid motion changes.

    `shell_counts` without signs; rows have unit length: square roots of shares (Hellinger), so that
    a dot product compares two of them. `radius` is in the unit of the points; the caller gives it
    as a multiple of their spacing, which makes the result independent of scale. Without
    `keypoints`, all points are described.
    """
    if keypoints is None:
        keypoints = torch.arange(len(points), device=points.device)
    points = points - points.mean(0)
    distance = distances(points, keypoints)
    counts = shell_counts(
        points, normals, area, distance, keypoints, radius=radius, shells=shells, bins=bins
    ).flatten(1)
    return (counts / counts.sum(-1, keepdim=True).clamp_min(1e-12)).sqrt_()


def shell_counts(
    points: Float[Tensor, "n 3"],
    normals: Float[Tensor, "n 3"],
    area: Float[Tensor, " n"],
    distance: Float[Tensor, "k n"],
    keypoints: Int[Tensor, " k"],
    *,
    radius: float,
    shells: int,
    bins: int,
    signed: bool = False,
    power: float = 1.0,
) -> Float[Tensor, "k shells c"]:
    """Histograms of three pair angles around each keypoint, `bins` bins each, one a shell.

    For a keypoint i and each point j with 0 < |d| < `radius`, d = pⱼ − pᵢ, the numbers
    cos ∠(nᵢ, d), cos ∠(nⱼ, d) and cos ∠(nᵢ, nⱼ), or their absolute values unless `signed`, are
    counted in shells of (|d|/radius)^`power`. Membership is linear between bin centers, in distance
    and in angle, so noise moves counts smoothly, and each point j counts with the `area` that it
    stands for, so that dense parts don't drown the others. The points lie around the origin, and
    `distance` are their `distances`. Cost: k n.
    """
    at, at_normals = points[keypoints], normals[keypoints]
    above = (normals * points).sum(-1)
    own = (at_normals @ points.T).sub_(above[keypoints].unsqueeze(-1))
    other = (at @ normals.T).neg_().add_(above)
    inverse = distance.clamp_min(1e-12).reciprocal_()
    cosines = [own.mul_(inverse), other.mul_(inverse), at_normals @ normals.T]
    for cosine in cosines:
        if signed:
            cosine.add_(1).mul_(0.5 * bins).sub_(0.5)
        else:
            cosine.abs_().mul_(bins).sub_(0.5)
    weight = unit_step(radius - distance).mul_(unit_step(distance - 1e-6 * radius)).mul_(area)
    shell = shell_position(distance, radius=radius, shells=shells, power=power)
    k, n = distance.shape
    counts = points.new_empty(k, shells, 1 + 3 * (bins - 1))
    in_shell = points.new_empty(_ROWS_AT_ONCE, shells, n)
    in_bin = points.new_ones(_ROWS_AT_ONCE, 1 + 3 * (bins - 1), n)
    shell_starts, bin_starts = ramp_starts(shells, like=shell), ramp_starts(bins, like=shell)[1:]
    for first in range(0, k, _ROWS_AT_ONCE):
        rows = slice(first, min(first + _ROWS_AT_ONCE, k))
        block = slice(0, rows.stop - first)
        ramps(shell[rows], shell_starts, out=in_shell[block]).mul_(weight[rows].unsqueeze(-2))
        for number, cosine in enumerate(cosines):
            part = slice(1 + number * (bins - 1), 1 + (number + 1) * (bins - 1))
            ramps(cosine[rows], bin_starts, out=in_bin[block, part])
        torch.bmm(in_shell[block], in_bin[block].mT, out=counts[rows])
    counts = between_ramps(counts, 1)
    total, parts = counts[..., :1], counts[..., 1:].unflatten(-1, (3, bins - 1))
    parts = torch.cat([total.unsqueeze(-2).expand(-1, -1, 3, -1), parts], -1)
    # Differences of sums: what should be zero may be a little less.
    return between_ramps(parts, -1).clamp_min_(0).flatten(-2)


def distances(points: Float[Tensor, "n 3"], keypoints: Int[Tensor, " k"]) -> Float[Tensor, "k n"]:
    """From each keypoint to all points; exact for near ones."""
    x, y, z = (axis[keypoints].unsqueeze(-1) - axis for axis in points.T.contiguous())
    return x.square_().addcmul_(y, y).addcmul_(z, z).sqrt_()


def shell_position(
    distance: Float[Tensor, "n m"], *, radius: float, shells: int, power: float
) -> Float[Tensor, "n m"]:
    """Where in the row of shells a distance lies: k at the center of shell k."""
    relative = distance / radius
    if power != 1.0:
        # Powers are slow; 0 stays 0.
        relative = relative.clamp_max_(1.0).log2_().mul_(power).exp2_()
    return relative.mul_(shells).sub_(0.5)


def ramp_starts(count: int, *, like: Tensor) -> Float[Tensor, "count 1"]:
    """Where the `ramps` of so many bins begin: the first one everywhere, k at center k − 1."""
    starts = torch.arange(-1, count - 1, dtype=like.dtype, device=like.device)
    starts[0] = -torch.inf
    return starts[:, None]


def ramps(
    position: Float[Tensor, "n m"], starts: Float[Tensor, "c 1"], *, out: Tensor
) -> Float[Tensor, "n c m"]:
    """How far each position is along the ramps, of length 1, that begin at `starts`; in [0, 1].

    The share of a position in bin k, linear between centers, is ramp k − ramp k + 1: sums over
    ramps cost less than half of those over shares (`between_ramps`).
    """
    return torch.sub(position.unsqueeze(-2), starts, out=out).clamp_(0, 1)


def between_ramps(sums: Float[Tensor, "..."], dim: int) -> Float[Tensor, "..."]:
    """Sums over bins, from sums over the `ramps` of the same bins along `dim`."""
    return torch.cat(
        [-sums.diff(dim=dim), sums.narrow(dim, sums.shape[dim] - 1, 1)],
        dim,
    )
