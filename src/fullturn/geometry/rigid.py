"""Rigid motions as 4×4 matrices: group operations, exponential and logarithm, random rotations."""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

# Below these squared angles a power series is used: there it is exact to float64 rounding, while
# the closed form divides by zero at 0 and loses digits near it.
_SERIES_BELOW_SQ = 0.1
# In units of the sine of the half angle.
_LOG_SERIES_BELOW_SQ = 1e-3


def make(
    R: Float[Tensor, "*#batch 3 3"], t: Float[Tensor, "*#batch 3"]
) -> Float[Tensor, "... 4 4"]:
    """Build the 4×4 matrix [R t; 0 1].

    >>> make(torch.eye(3), torch.tensor([1.0, 2.0, 3.0]))[:3, 3]
    tensor([1., 2., 3.])
    """
    if R.shape[:-2] != t.shape[:-1]:
        batch = torch.broadcast_shapes(R.shape[:-2], t.shape[:-1])
        R, t = R.expand(*batch, 3, 3), t.expand(*batch, 3)
    top = torch.cat([R, t.unsqueeze(-1)], -1)
    last = torch.eye(4, dtype=top.dtype, device=top.device)[3:]
    return torch.cat([top, last.expand(*top.shape[:-2], 1, 4)], -2)


def invert(T_a_b: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 4 4"]:
    """Invert a rigid motion: T_b_a = [Rᵀ  −Rᵀt; 0 1]."""
    R_b_a = T_a_b[..., :3, :3].mT
    return make(R_b_a, -(R_b_a @ T_a_b[..., :3, 3:])[..., 0])


def apply(
    T_target_source: Float[Tensor, "*#batch 4 4"], points: Float[Tensor, "*#batch n 3"]
) -> Float[Tensor, "... n 3"]:
    """Move points: R p + t for each row p; batch dimensions broadcast."""
    return points @ T_target_source[..., :3, :3].mT + T_target_source[..., None, :3, 3]


def exp_so3(rotation_vector: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation matrix of a rotation vector (axis times angle in radians).

    Rodrigues: R = I + (sin θ/θ) K + ((1 − cos θ)/θ²) K², with K the cross-product matrix.
    """
    K = skew(rotation_vector)
    sinc, cosc, _ = _exp_coefficients(rotation_vector.square().sum(-1))
    return _eye_like(K) + sinc * K + cosc * (K @ K)


def log_so3(R: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 3"]:
    """Rotation vector (rad, length in [0, π]) of a rotation matrix; inverse of `exp_so3`.

    Goes through the unit quaternion (w, v): 2 atan2(|v|, w) v/|v|. At exactly π both signs of the
    axis are right, and which one comes is arbitrary.
    """
    w, v = _quaternion(R)
    length_sq = v.square().sum(-1)
    small = length_sq < _LOG_SERIES_BELOW_SQ
    length = torch.where(small, 1.0, length_sq).sqrt()
    # Where small, w is near 1; elsewhere a safe stand-in keeps the unused branch finite.
    safe_w = torch.where(small, w, 1.0)
    x_sq = torch.where(small, length_sq, 0.0) / safe_w.square()
    series = 2 / safe_w * _horner(x_sq, [1.0, -1 / 3, 1 / 5, -1 / 7, 1 / 9, -1 / 11])
    return torch.where(small, series, 2 * torch.atan2(length, w) / length)[..., None] * v


def exp_se3(twist: Float[Tensor, "*batch 6"]) -> Float[Tensor, "*batch 4 4"]:
    """Rigid motion of a twist: rotation vector (rad), then translation part.

    t = V ρ with V = I + ((1 − cos θ)/θ²) K + ((θ − sin θ)/θ³) K².
    """
    rotation_vector, rho = twist[..., :3], twist[..., 3:]
    K = skew(rotation_vector)
    K_sq = K @ K
    sinc, cosc, cubic = _exp_coefficients(rotation_vector.square().sum(-1))
    eye = _eye_like(K)
    V = eye + cosc * K + cubic * K_sq
    return make(eye + sinc * K + cosc * K_sq, (V @ rho[..., None])[..., 0])


def log_se3(T_target_source: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 6"]:
    """Twist (rotation vector in rad, then translation part) of a motion; inverse of `exp_se3`.

    ρ = V⁻¹ t with V⁻¹ = I − K/2 + ((1 − (θ/2) cot(θ/2))/θ²) K².
    """
    rotation_vector = log_so3(T_target_source[..., :3, :3])
    K = skew(rotation_vector)
    angle_sq = rotation_vector.square().sum(-1)
    small = angle_sq < _SERIES_BELOW_SQ
    safe_sq = torch.where(small, 1.0, angle_sq)
    half = safe_sq.sqrt() / 2
    closed = (1 - half * half.cos() / half.sin()) / safe_sq
    # Bernoulli numbers: the series of (1 − (θ/2) cot(θ/2))/θ².
    series = _horner(
        torch.where(small, angle_sq, 0.0),
        [1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000],
    )
    V_inverse = _eye_like(K) - K / 2 + torch.where(small, series, closed)[..., None, None] * (K @ K)
    rho = (V_inverse @ T_target_source[..., :3, 3:])[..., 0]
    return torch.cat([rotation_vector, rho], dim=-1)


def skew(v: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """[v]ₓ, so that [v]ₓ u = v × u."""
    x, y, z = v.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))


def rotation_angle_rad(R: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch"]:
    """Angle of a rotation in [0, π]: atan2(2 sin θ, 2 cos θ), exact near 0 and near π.

    The difference of two rotations is ``rotation_angle_rad(Ra.mT @ Rb)``. The gradient at the
    identity, where the angle has a kink, is 0.
    """
    sine = torch.linalg.vector_norm(_twice_axial(R), dim=-1)
    return torch.atan2(sine, R.diagonal(dim1=-2, dim2=-1).sum(-1) - 1)


def rotation_from_axis_angle(
    axis: Float[Tensor, "*#batch 3"], angle_rad: Float[Tensor, "*#batch"]
) -> Float[Tensor, "... 3 3"]:
    """Rotation about an axis of any length by an angle (rad); a zero axis gives the identity."""
    length = torch.linalg.vector_norm(axis, dim=-1, keepdim=True)
    return exp_so3(axis / torch.where(length > 0, length, 1.0) * angle_rad[..., None])


def random_rotations_uniform(count: int, *, rng: np.random.Generator) -> Float[Tensor, "count 3 3"]:
    """Rotations uniform on SO(3) (Haar measure; float64), from Gaussian quaternions.

    The mean angle is π/2 + 2/π rad = 126.5°.
    """
    q = torch.from_numpy(rng.standard_normal((count, 4)))
    q = q / torch.linalg.vector_norm(q, dim=-1, keepdim=True)
    w, v = q[:, :1, None], q[:, 1:]
    K = skew(v)
    return _eye_like(K) + 2 * w * K + 2 * (K @ K)


def _exp_coefficients(angle_sq: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """sin θ/θ, (1 − cos θ)/θ² and (θ − sin θ)/θ³ of θ², each with two trailing axes of size 1."""
    small = angle_sq < _SERIES_BELOW_SQ
    # Both branches get a harmless input where they are not used, or their gradients give NaN.
    safe_sq = torch.where(small, 1.0, angle_sq)
    x = torch.where(small, angle_sq, 0.0)
    angle = safe_sq.sqrt()
    sine = angle.sin()
    sinc = torch.where(small, _series(x, 1), sine / angle)
    cosc = torch.where(small, _series(x, 2), 2 * (angle / 2).sin().square() / safe_sq)
    cubic = torch.where(small, _series(x, 3), (angle - sine) / (angle * safe_sq))
    return sinc[..., None, None], cosc[..., None, None], cubic[..., None, None]


def _series(x: Tensor, offset: int) -> Tensor:
    """Σ (−x)ⁿ/(2n + offset)!."""
    return _horner(x, [(-1) ** n / math.factorial(2 * n + offset) for n in range(7)])


def _horner(x: Tensor, coefficients: list[float]) -> Tensor:
    """Polynomial with the given coefficients, the constant one first."""
    value = torch.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = value * x + coefficient
    return value


def _quaternion(R: Tensor) -> tuple[Tensor, Tensor]:
    """Unit quaternion as (w ≥ 0, vector part).

    4 q qᵀ is linear in R. Its row with the largest diagonal entry, normalized, is ±q: there is no
    square root of a small number, so values and gradients are stable for every rotation.
    """
    d = R.diagonal(dim1=-2, dim2=-1)
    axial = _twice_axial(R)
    trace = d.sum(-1, keepdim=True)
    diagonal = torch.cat([1 + trace, 1 + 2 * d - trace], dim=-1)
    symmetric = R + R.mT
    vector_block = symmetric - torch.diag_embed(2 * d) + torch.diag_embed(diagonal[..., 1:])
    rows = torch.cat(
        [
            torch.cat([diagonal[..., :1], axial], dim=-1)[..., None, :],
            torch.cat([axial[..., None], vector_block], dim=-1),
        ],
        dim=-2,
    )
    best = diagonal.argmax(-1)[..., None, None].expand(*rows.shape[:-2], 1, 4)
    row = rows.gather(-2, best)[..., 0, :]
    q = row / torch.linalg.vector_norm(row, dim=-1, keepdim=True)
    q = torch.where(q[..., :1] < 0, -q, q)
    return q[..., 0], q[..., 1:]


def _twice_axial(matrix: Tensor) -> Tensor:
    """Twice the skew part of a matrix as a vector: of a rotation, 2 sin θ times the axis."""
    entries = (matrix - matrix.mT).flatten(-2).unbind(-1)
    return torch.stack([entries[7], entries[2], entries[3]], dim=-1)


def _eye_like(matrix: Tensor) -> Tensor:
    return torch.eye(3, dtype=matrix.dtype, device=matrix.device).expand_as(matrix)
