"""The least-squares problem of point-to-plane ICP, for many poses at once."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor


def plane_equations(
    at: Float[Tensor, "3 *batch n"],
    difference: Float[Tensor, "3 *batch n"],
    normal: Float[Tensor, "3 *batch n"],
    weight: Float[Tensor, "*batch n"],
) -> tuple[Float[Tensor, "*batch 6 6"], Float[Tensor, "*batch 6"]]:
    """H = Σ w JᵀJ and g = Σ w Jᵀr of a small motion (ω, v) of the points: x → x + ω × x + v.

    Residuals are heights above tangent planes: r = n·d with d the `difference` between a point and
    its partner, J = [x × n, n]. Coordinates come first; H and g are blocks of one product.
    """
    x, y, z = at.unbind()
    nx, ny, nz = normal.unbind()
    dx, dy, dz = difference.unbind()
    rows = at.new_empty(7, *at.shape[1:])
    turn_x, turn_y, turn_z, *_, height = rows.unbind()
    torch.mul(y, nz, out=turn_x).addcmul_(z, ny, value=-1)
    torch.mul(z, nx, out=turn_y).addcmul_(x, nz, value=-1)
    torch.mul(x, ny, out=turn_z).addcmul_(y, nx, value=-1)
    rows[3:6] = normal
    torch.mul(dx, nx, out=height).addcmul_(dy, ny).addcmul_(dz, nz)
    product = (rows * weight).movedim(0, -2) @ rows.movedim(0, -1)
    return product[..., :6, :6], product[..., :6, 6]


def gauss_newton_step(
    H: Float[np.ndarray, "*batch 6 6"],
    g: Float[np.ndarray, "*batch 6"],
    *,
    damping: float,
    largest: float = 0.5,
) -> Float[np.ndarray, "*batch 6"]:
    """−H⁻¹g, damped by `damping` times the mean diagonal of H, no entry above `largest`.

    Zero where nothing pulls. Damping holds back what the residuals leave free. In NumPy: of a few
    poses, what takes time is the number of calls.
    """
    size = np.trace(H, axis1=-2, axis2=-1)[..., None, None] / 6
    damped = H + (damping * size + np.finfo(H.dtype).tiny ** 0.5) * np.eye(6, dtype=H.dtype)
    return np.clip(-np.linalg.solve(damped, g[..., None])[..., 0], -largest, largest)
