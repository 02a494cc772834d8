"""Fast point feature histograms: the curvature of a neighborhood in 33 numbers.

After Rusu, Blodow and Beetz, "Fast Point Feature Histograms (FPFH) for 3D registration" (ICRA
2009).
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.geometry.neighbors import radius_neighbors

_BINS = 11
_PAIRS_AT_ONCE = 1 << 14


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
    *batch, n, _ = points.shape
    index, distance = radius_neighbors(points, points, radius, max_neighbors=max_neighbors)
    # One long list of points, whatever the batch; from here on row i and its neighbors index it.
    points, normals = points.reshape(-1, 3), normals.reshape(-1, 3)
    distance = distance.view(-1, max_neighbors)
    first = torch.arange(len(points), device=points.device) // n * n
    index = torch.where(index < 0, 0, index).view(-1, max_neighbors) + first[:, None]
    paired = (distance > 0) & torch.isfinite(distance)

    # In parts that stay in the processor's cache.
    rows = max(1, _PAIRS_AT_ONCE // max_neighbors)
    parts = zip(
        points.split(rows), normals.split(rows), index.split(rows), paired.split(rows), strict=True
    )
    spfh = torch.cat(
        [_spfh(points[j] - p[:, None], n_i, normals[j], on) for p, n_i, j, on in parts]
    )

    weights = torch.where(paired, 1 / torch.where(paired, distance, 1.0).square(), 0.0)
    weighted = torch.nn.functional.embedding_bag(
        index, spfh.flatten(-2), mode="sum", per_sample_weights=weights
    ).view_as(spfh)
    total = weighted.sum(-1, keepdim=True)
    features = spfh + 100 * weighted / torch.where(total > 0, total, 1.0)
    return features.view(*batch, n, 3 * _BINS)


def _spfh(
    d: Float[Tensor, "m k 3"],
    n_i: Float[Tensor, "m 3"],
    n_j: Float[Tensor, "m k 3"],
    paired: Bool[Tensor, "m k"],
) -> Float[Tensor, "m 3 11"]:
    """Histograms of each point's own pairs, each summing to 100."""
    angle, v_cosine, u_cosine, has_frame = _darboux(d, n_i[:, None].expand_as(n_j), n_j)
    shares = torch.stack([angle / (2 * math.pi) + 0.5, v_cosine / 2 + 0.5, u_cosine / 2 + 0.5], 1)
    # A pair without a frame (d along the normal) has all three angles 0: the middle bins.
    shares = torch.where(has_frame[:, None], shares, 0.5)
    bins = (shares * _BINS).floor().long().clamp_(0, _BINS - 1)
    counts = torch.zeros((len(d), 3, _BINS), dtype=d.dtype, device=d.device)
    # Sums of ones are exact in any order, so this is deterministic on every device.
    counts.scatter_add_(-1, bins, paired.to(d.dtype)[:, None].expand(bins.shape))
    return counts * (100 / paired.sum(-1).clamp_min(1).to(d.dtype))[:, None, None]


def _darboux(d: Tensor, n_i: Tensor, n_j: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The angle and two cosines of each pair in its Darboux frame, and where it has a frame."""
    # Components first: sums over them run along contiguous memory.
    d, n_i, n_j = (vectors.movedim(-1, 0).contiguous() for vectors in (d, n_i, n_j))
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
