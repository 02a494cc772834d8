"""Fast point feature histograms: the curvature of a neighborhood in 33 numbers.

After Rusu, Blodow and Beetz, "Fast Point Feature Histograms (FPFH) for 3D registration" (ICRA
2009).
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from fullturn.geometry.neighbors import gather, radius_neighbors

_BINS = 11


def fpfh(
    points: Float[Tensor, "*batch n 3"],
    normals: Float[Tensor, "*batch n 3"],
    *,
    radius: float = 0.1,
    max_neighbors: int = 30,
) -> Float[Tensor, "*batch n 33"]:
    """Histograms (11 bins each) of the Darboux angles of a point's pairs and its neighbors' pairs.

    1. Pairs: each point with its neighbors within `radius`, at most `max_neighbors` with itself.
    2. SPFH: three histograms over a point's pairs, each summing to 100.
    3. FPFH: own SPFH + Σ_j SPFH_j/d_j², that sum rescaled to 100 per histogram.

    So each histogram of a point sums to 200, or to 0 where it has no neighbor. The order of the
    channels is that of Open3D: atan2(w·n_j, u·n_j), v·n_j, u·d/|d|. Coincident points make no
    pair.
    """
    batch = points.shape[:-2]
    n = points.shape[-2]
    index, _ = radius_neighbors(points, points, radius, max_neighbors=max_neighbors)
    d = (gather(points, index) - points[..., None, :]).movedim(-1, 0).contiguous()
    distance_sq = d.square().sum(0)
    paired = (index >= 0) & (distance_sq > 0)
    spfh = _spfh(d, normals, index, paired)

    weights = torch.where(paired, 1 / torch.where(paired, distance_sq, 1.0), 0.0)
    weighted = _weighted_sum(spfh.view(-1, 3 * _BINS), index, weights).view(*batch, n, 3, _BINS)
    total = weighted.sum(-1, keepdim=True)
    return (spfh + 100 * weighted / torch.where(total > 0, total, 1.0)).flatten(-2)


def _spfh(
    d: Tensor, normals: Tensor, index: Int[Tensor, "*batch n k"], paired: Tensor
) -> Float[Tensor, "*batch n 3 11"]:
    """Histograms of each point's own pairs, each summing to 100."""
    angle, v_cosine, u_cosine, has_frame = _darboux(d, normals, index)
    shares = torch.stack([angle / (2 * math.pi) + 0.5, v_cosine / 2 + 0.5, u_cosine / 2 + 0.5], -2)
    # A pair without a frame (d along the normal) has all three angles 0: the middle bins.
    shares = torch.where(has_frame[..., None, :], shares, 0.5)
    bins = (shares * _BINS).floor().long().clamp_(0, _BINS - 1)
    counts = torch.zeros((*bins.shape[:-1], _BINS), dtype=d.dtype, device=d.device)
    # Sums of ones are exact in any order, so this is deterministic on every device.
    ones = paired.to(d.dtype)[..., None, :].expand(bins.shape)
    counts.scatter_add_(-1, bins, ones)
    return counts * (100 / paired.sum(-1).clamp_min(1).to(d.dtype))[..., None, None]


def _darboux(d: Tensor, normals: Tensor, index: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The angle and two cosines of each pair in its Darboux frame, and where it has a frame.

    d comes with its components first.
    """
    n_j = gather(normals, index).movedim(-1, 0).contiguous()
    n_i = normals.movedim(-1, 0)[..., None].expand_as(n_j)
    length = d.square().sum(0).sqrt()
    unit = d / torch.where(length > 0, length, 1.0)
    cosine_i, cosine_j = (n_i * unit).sum(0), (n_j * unit).sum(0)
    # The frame stands on the point whose normal is nearer to the line between the two.
    # Neighbors with one and the same neighborhood have equal normals: not decided by rounding.
    tie = 16 * torch.finfo(d.dtype).eps
    swap = cosine_i.abs() + tie < cosine_j.abs()
    u, n_t = torch.where(swap, n_j, n_i), torch.where(swap, n_i, n_j)
    unit = torch.where(swap, -unit, unit)
    u_cosine = torch.where(swap, -cosine_j, cosine_i)

    v = torch.linalg.cross(unit, u, dim=0)
    v_length = v.square().sum(0).sqrt()
    has_frame = v_length > 0
    v = v / torch.where(has_frame, v_length, 1.0)
    w = torch.linalg.cross(u, v, dim=0)
    angle = torch.atan2((w * n_t).sum(0), (u * n_t).sum(0))
    return angle, (v * n_t).sum(0), u_cosine, has_frame


def _weighted_sum(values: Tensor, index: Tensor, weights: Tensor) -> Tensor:
    """Σ_j weights_j values[index_j] for each row, without holding all gathered rows at once."""
    n, k = index.shape[-2:]
    rows = index.clamp_min(0).view(-1, n, k)
    rows = rows + n * torch.arange(len(rows), device=rows.device)[:, None, None]
    return torch.nn.functional.embedding_bag(
        rows.view(-1, k), values, mode="sum", per_sample_weights=weights.view(-1, k)
    )
