"""What each descriptor is invariant to, and the check that this is true."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from fullturn.errors import InputError
from fullturn.features.coordinates import delta_xyz, xyz
from fullturn.features.fpfh import fpfh
from fullturn.features.ppf import ppf
from fullturn.features.rri import rri
from fullturn.geometry.neighbors import knn
from fullturn.geometry.rigid import random_rotations_uniform

# From points (n, 3), unit normals (n, 3) and neighbors (n, k), the point itself first, to
# features (n, …).
Compute = Callable[
    [Float[Tensor, "n 3"], Float[Tensor, "n 3"], Int[Tensor, "n k"]], Float[Tensor, "n ..."]
]


@dataclass(frozen=True)
class Invariance:
    """Changes of the input that leave a point's features as they are.

    The normals turn with the points. What an orientation rule makes of them is a matter of
    `geometry.normals`, not of the descriptor.
    """

    rotation: bool
    translation: bool
    scale: bool
    normal_sign: bool  # each normal may flip on its own
    permutation: bool  # points in another order: the rows follow, nothing else changes


@dataclass(frozen=True)
class Feature:
    """A descriptor with its declared invariance."""

    compute: Compute
    channels: int  # per neighbor, or per point where there is no neighbor axis
    invariance: Invariance


FEATURES: dict[str, Feature] = {
    "xyz": Feature(
        compute=lambda points, normals, neighbor_index: xyz(points, neighbor_index),
        channels=3,
        invariance=Invariance(
            rotation=False, translation=False, scale=False, normal_sign=True, permutation=True
        ),
    ),
    "delta_xyz": Feature(
        compute=lambda points, normals, neighbor_index: delta_xyz(points, neighbor_index),
        channels=3,
        invariance=Invariance(
            rotation=False, translation=True, scale=False, normal_sign=True, permutation=True
        ),
    ),
    "ppf": Feature(
        compute=ppf,
        channels=4,
        invariance=Invariance(
            rotation=True, translation=True, scale=False, normal_sign=False, permutation=True
        ),
    ),
    "ppf_folded": Feature(
        compute=lambda points, normals, neighbor_index: ppf(
            points, normals, neighbor_index, fold=True
        ),
        channels=4,
        invariance=Invariance(
            rotation=True, translation=True, scale=False, normal_sign=True, permutation=True
        ),
    ),
    "rri": Feature(
        compute=lambda points, normals, neighbor_index: rri(points, neighbor_index),
        channels=4,
        invariance=Invariance(
            rotation=True, translation=True, scale=False, normal_sign=True, permutation=True
        ),
    ),
    "fpfh": Feature(
        compute=lambda points, normals, neighbor_index: fpfh(points, normals),
        channels=33,
        invariance=Invariance(
            rotation=True, translation=True, scale=False, normal_sign=False, permutation=True
        ),
    ),
}


def assert_invariant(
    compute: Compute,
    points: Float[Tensor, "n 3"],
    normals: Float[Tensor, "n 3"],
    *,
    to: str,
    rng: np.random.Generator,
    k: int = 12,
    tolerance: float | None = None,
) -> None:
    """Raise AssertionError unless a random change named `to` leaves the features as they are.

    `to` is a field of `Invariance`. Neighbors are searched anew after the change. `tolerance` is
    relative to the largest value of each channel (the last axis); it defaults to 1e-7 in float64
    and 1e-3 in float32.
    """
    order = torch.arange(len(points), device=points.device)
    changed_points, changed_normals = points, normals
    if to == "rotation":
        R = random_rotations_uniform(1, rng=rng)[0].to(points)
        changed_points, changed_normals = points @ R.mT, normals @ R.mT
    elif to == "translation":
        shift = torch.from_numpy(rng.standard_normal(3)).to(points)
        changed_points = points + shift * points.std()
    elif to == "scale":
        changed_points = points * rng.uniform(1.5, 2.5)
    elif to == "normal_sign":
        signs = torch.from_numpy(rng.choice([-1.0, 1.0], size=(len(points), 1))).to(points)
        changed_normals = normals * signs
    elif to == "permutation":
        order = torch.from_numpy(rng.permutation(len(points))).to(points.device)
        changed_points, changed_normals = points[order], normals[order]
    else:
        names = ", ".join(field.name for field in fields(Invariance))
        raise InputError(f"to must be one of {names}, got {to!r}")

    before = compute(points, normals, knn(points, points, k)[0])[order]
    after = compute(changed_points, changed_normals, knn(changed_points, changed_points, k)[0])
    if tolerance is None:
        tolerance = 1e-7 if points.dtype == torch.float64 else 1e-3
    size = before.abs().flatten(0, -2).amax(0)
    # A channel that is all but 0 is measured against the others: rounding is no difference.
    size = size.clamp_min(1e-3 * float(size.max()))
    difference = (after - before).abs().flatten(0, -2).amax(0)
    if not bool((difference <= tolerance * size).all()):
        worst = int((difference / size).argmax())
        raise AssertionError(
            f"not invariant to {to}: channel {worst}, of size {float(size[worst]):.3g}, differs by "
            f"{float(difference[worst]):.3g}; the tolerance is {tolerance:.3g} of its size"
        )
