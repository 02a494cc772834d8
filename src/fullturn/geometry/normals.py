"""Surface normals by local principal component analysis, and how they are oriented."""

from __future__ import annotations

from typing import Literal, get_args

import torch
from jaxtyping import Float, Int
from torch import Tensor

from fullturn.errors import InputError
from fullturn.geometry.neighbors import gather, knn

Orientation = Literal["origin", "viewpoint", "centroid", "none"]

# Neighbors whose coordinates are held at once: 3 MB in float64, whatever the size of the cloud.
_NEIGHBORS_AT_ONCE = 1 << 17


def estimate_normals(
    points: Float[Tensor, "n 3"],
    *,
    neighbor_index: Int[Tensor, "q k"] | None = None,
    k: int = 20,
    orientation: Orientation = "centroid",
    viewpoint: Float[Tensor, "3"] | None = None,
    queries: Float[Tensor, "q 3"] | None = None,
) -> Float[Tensor, "q 3"]:
    """Normal at each query (default: each point): least variance direction of its neighborhood.

    The neighborhood is `neighbor_index` (−1 where a neighbor is missing) or else the `k` nearest
    points, the query itself included if it is one of them. With one neighbor, or with all of them
    on a line, the normal is some unit vector, perpendicular to the line.

    The sign follows `orientation`:

    - ``centroid``: away from the mean of `points`; moves along with any rigid motion of the cloud.
    - ``origin``: towards the origin (the paper's); moves along with rotations only.
    - ``viewpoint``: towards the sensor at `viewpoint`; moves along if the viewpoint does.
    - ``none``: the coordinate of largest size is positive; means nothing, but is deterministic.

    Where the rule does not decide (a normal perpendicular to its direction, as all over a flat
    cloud under ``centroid``) the sign is that of ``none``.
    """
    _check(orientation, viewpoint)
    points = points.detach()
    at = points if queries is None else queries.detach()
    if neighbor_index is None:
        neighbor_index, _ = knn(at, points, k)
    elif neighbor_index.shape[0] != at.shape[0]:
        raise InputError(
            f"neighbor_index must have one row per query, {at.shape[0]}, "
            f"got {neighbor_index.shape[0]}"
        )
    rows = max(1, _NEIGHBORS_AT_ONCE // neighbor_index.shape[-1])
    parts = zip(at.split(rows), neighbor_index.split(rows), strict=True)
    covariance = torch.cat([_covariance(points, some, index) for some, index in parts])
    _, eigenvectors = eigen_symmetric_3x3(covariance)
    normals = _largest_positive(eigenvectors[..., 0])
    if orientation == "none":
        return normals
    return oriented(normals, _direction(points, at, orientation, viewpoint))


def oriented(
    normals: Float[Tensor, "n 3"], direction: Float[Tensor, "n 3"]
) -> Float[Tensor, "n 3"]:
    """Normals turned over where they point away from the direction; kept where that is unclear."""
    towards = (normals * direction).sum(-1)
    undecided = 256 * torch.finfo(normals.dtype).eps * torch.linalg.vector_norm(direction, dim=-1)
    return torch.where((towards < -undecided)[:, None], -normals, normals)


def eigen_symmetric_3x3(
    A: Float[Tensor, "*batch 3 3"],
) -> tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3 3"]]:
    """Eigenvalues (ascending) and eigenvectors (columns) of symmetric 3×3 matrices, closed form.

    The trigonometric formula gives only the best separated eigenvalue, where it is accurate; its
    eigenvector is a cross product of two rows. The other two come from the 2×2 problem in the
    plane perpendicular to it. So the basis is orthonormal and right-handed and the residual is at
    rounding level for every input, double and triple eigenvalues and zero included. Gradients are
    finite only where the eigenvalues differ.
    """
    # Components come first from here on: contiguous memory makes this twice as fast.
    A = A.movedim((-2, -1), (0, 1)).contiguous()

    # 1. Split off the mean, and bring what is left to size 1.
    mean = (A[0, 0] + A[1, 1] + A[2, 2]) / 3
    deviator = A - mean * _eye(A)
    size = deviator.abs().amax((0, 1))
    B = deviator / torch.where(size > 0, size, 1.0)

    # 2. The isolated eigenvalue: the largest if det B ≥ 0, else the smallest.
    det = (B[0] * torch.linalg.cross(B[1], B[2], dim=0)).sum(0)
    p = (B.square().sum((0, 1)) / 6).sqrt()
    positive = det >= 0
    cosine = (det.abs() / (2 * torch.where(p > 0, p, 1.0) ** 3)).clamp(max=1.0)
    isolated = torch.where(positive, 2.0, -2.0) * p * torch.cos(torch.acos(cosine) / 3)

    # 3. Its eigenvector u, and a basis v, w of the plane perpendicular to it.
    u = _null_vector(B, isolated)
    v = perpendicular(u)
    w = torch.linalg.cross(u, v, dim=0)

    # 4. The 2×2 problem [vBv vBw; vBw wBw].
    Bv, Bw = (B * v).sum(1), (B * w).sum(1)
    vv, vw, ww = (v * Bv).sum(0), (v * Bw).sum(0), (w * Bw).sum(0)
    half_sum, half_difference = (vv + ww) / 2, (vv - ww) / 2
    spread = torch.hypot(half_difference, vw)
    angle = torch.atan2(vw, half_difference) / 2
    cos, sin = angle.cos(), angle.sin()
    high, low = cos * v + sin * w, cos * w - sin * v

    # 5. In ascending order, right-handed. Of trace 0, so the isolated eigenvalue is −2 half_sum.
    first = torch.where(positive, low, u)
    second = torch.where(positive, high, low)
    vectors = torch.stack([first, second, torch.linalg.cross(first, second, dim=0)], dim=1)
    lower, upper = half_sum - spread, half_sum + spread
    isolated = -2 * half_sum
    values = torch.stack(
        [
            torch.where(positive, lower, isolated),
            torch.where(positive, upper, lower),
            torch.where(positive, isolated, upper),
        ]
    )
    # The order can be off by a rounding error where all three nearly agree.
    values = mean + size * values.cummax(0).values
    return values.movedim(0, -1), vectors.movedim((0, 1), (-2, -1))


def _check(orientation: str, viewpoint: Tensor | None) -> None:
    if orientation not in get_args(Orientation):
        raise InputError(
            f"orientation must be one of {', '.join(get_args(Orientation))}, got {orientation!r}"
        )
    if orientation == "viewpoint" and viewpoint is None:
        raise InputError("orientation 'viewpoint' needs the sensor position: pass viewpoint=(3,)")


def _covariance(points: Tensor, at: Tensor, neighbor_index: Tensor) -> Tensor:
    """Covariance of each neighborhood; lengths are relative to the query before anything else."""
    present = (neighbor_index >= 0).to(points.dtype)
    count = present.sum(-1).clamp_min(1)
    # Components first: sums along contiguous memory are several times faster.
    offset = (gather(points, neighbor_index) - at[:, None]).permute(2, 0, 1).contiguous()
    offset *= present
    offset -= (offset.sum(-1) / count)[..., None]
    offset *= present
    x, y, z = offset
    pairs = [x * x, x * y, x * z, y * y, y * z, z * z]
    xx, xy, xz, yy, yz, zz = (pair.sum(-1) / count for pair in pairs)
    return torch.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], dim=-1).unflatten(-1, (3, 3))


def _direction(
    points: Tensor, at: Tensor, orientation: Orientation, viewpoint: Tensor | None
) -> Tensor:
    """Where the normal at each query should point to, up to 90°."""
    if orientation == "origin":
        return -at
    if viewpoint is not None and orientation == "viewpoint":
        return viewpoint.to(at) - at
    return at - points.mean(0)


def _largest_positive(vectors: Tensor) -> Tensor:
    largest = vectors.gather(-1, vectors.abs().argmax(-1, keepdim=True))
    return torch.where(largest < 0, -vectors, vectors)


def _null_vector(B: Tensor, eigenvalue: Tensor) -> Tensor:
    """Unit eigenvector, components first: the largest cross product of two rows of B − λ I."""
    M = B - eigenvalue * _eye(B)
    # Row i of the cofactors is the cross product of the other two rows of M.
    cofactors = torch.linalg.cross(M[[1, 2, 0]], M[[2, 0, 1]], dim=1)
    length_sq = cofactors.square().sum(1)
    vector, best_sq = cofactors[0], length_sq[0]
    for i in (1, 2):
        vector = torch.where(length_sq[i] > best_sq, cofactors[i], vector)
        best_sq = torch.maximum(length_sq[i], best_sq)
    # B = 0 has no direction of its own: any axis will do.
    length = torch.where(best_sq > 0, best_sq, 1.0).sqrt()
    return torch.where(best_sq > 0, vector / length, _eye(B)[0])


def perpendicular(u: Float[Tensor, " 3 *batch"]) -> Float[Tensor, " 3 *batch"]:
    """Unit vector perpendicular to a unit vector, components first; zero to a zero vector."""
    x, y, z = u
    # Drop the smaller of x and y, so that the length is at least √(1/2).
    drop_y = x.abs() > y.abs()
    zero = torch.zeros_like(x)
    length = torch.where(drop_y, x, y).square().add(z.square()).sqrt()
    across = [
        torch.where(drop_y, -z, zero),
        torch.where(drop_y, zero, z),
        torch.where(drop_y, x, -y),
    ]
    return torch.stack(across) / torch.where(length > 0, length, 1.0)


def _eye(like: Tensor) -> Tensor:
    """Identity with its components first, to broadcast against `like`."""
    eye = torch.eye(3, dtype=like.dtype, device=like.device)
    return eye.view(3, 3, *[1] * (like.ndim - 2))
