"""How much the handcrafted features of one cloud change with its pose and with noise."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from fullturn.features.coordinates import delta_xyz, xyz
from fullturn.features.fpfh import fpfh
from fullturn.features.ppf import ppf
from fullturn.features.rri import rri
from fullturn.geometry.neighbors import MISSING, knn
from fullturn.geometry.normals import Orientation, estimate_normals
from fullturn.geometry.rigid import rotation_from_axis_angle

INVARIANT = ("RRI", "PPF", "FPFH")
# Channels of one unit belong together: an average over lengths and angles has no meaning of its
# own.
UNITS: Mapping[str, Mapping[str, slice]] = {
    "XYZ": {"lengths": slice(0, 3)},
    "ΔXYZ": {"lengths": slice(0, 3)},
    "RRI": {"lengths": slice(0, 2), "angles": slice(2, 4)},
    "PPF": {"angles": slice(0, 3), "lengths": slice(3, 4)},
    "FPFH": {"percent": slice(0, 33)},
}
# A study of one cloud: values along the x axis by panel and feature.
Curves = dict[tuple[str, str], list[float]]


@dataclass(frozen=True)
class StudyConfig:
    """What is measured; lengths are in radii of the shape."""

    points: int = 2048
    neighbors: int = 8  # per point, itself first
    normal_radius: float = 0.1
    normal_neighbors: int = 30  # at most, the point itself included
    max_translation: float = 0.5  # along each axis
    jitter: float = 0.0  # noise on what is read; 1e-5 breaks the ties of points on a lattice
    angles_deg: tuple[float, ...] = tuple(20.0 * i for i in range(10))
    noise_sigmas: tuple[float, ...] = tuple(i / 100 for i in range(11))


class Search(NamedTuple):
    """Neighbors of each point: those that its features are about, and those of its normal."""

    neighbor_index: Int[Tensor, "n k"]
    normal_index: Int[Tensor, "n m"]  # −1 where there are fewer within the radius


class Agreement(NamedTuple):
    """What a cosine is made of, for each point."""

    dot: Tensor
    before_sq: Tensor
    after_sq: Tensor


def pose_similarity(
    points: Float[Tensor, "n 3"], translation: Float[Tensor, "3"], config: StudyConfig
) -> Curves:
    """Cosine between each point's features before and after a motion, averaged over the points.

    Panel "rotation": by each angle about z through the origin, where the cloud is centered. Panel
    "se3": the same, then the translation, by what stands in for the lost center: the rule that
    orients the normals (PPF, FPFH) or the center itself (RRI).
    """
    search = search_neighbors(points, config)
    rest = describe(points, search, config)
    outward = describe(points, search, config, rule="centroid", names=("PPF", "FPFH"))
    loose = _unoriented(points, search)
    curves: defaultdict[tuple[str, str], list[float]] = defaultdict(list)
    for angle in config.angles_deg:
        angle_rad = torch.tensor(math.radians(angle), dtype=points.dtype, device=points.device)
        R = rotation_from_axis_angle(points.new_tensor([0.0, 0.0, 1.0]), angle_rad)
        turned = points @ R.mT
        after = describe(turned, search_neighbors(turned, config), config)
        parts = {name: agreement(rest[name], after[name]) for name in rest}
        for label, value in _similarities(parts).items():
            curves["rotation", label].append(value)

        moved = turned + translation
        search = search_neighbors(moved, config)
        after = describe(moved, search, config)
        own = describe(moved, search, config, rule="centroid", names=("PPF", "FPFH"))
        own["RRI"] = rri(moved, search.neighbor_index)
        for name in rest:
            label = f"{name} (origin)" if name in INVARIANT else name
            curves["se3", label].append(cosine(agreement(rest[name], after[name])))
        for name in INVARIANT:
            # The center of the cloud at rest is the origin, so its RRI is the same either way.
            before = outward.get(name, rest[name])
            curves["se3", f"{name} (centroid)"].append(cosine(agreement(before, own[name])))
        for label, values in _unoriented(moved, search).items():
            curves["se3", label].append(cosine(agreement(loose[label], values)))
    return dict(curves)


def noise_error(
    points: Float[Tensor, "n 3"], rng: np.random.Generator, config: StudyConfig
) -> Curves:
    """Mean absolute change of the channels under Gaussian noise, in the units of each feature.

    Panel "noise": each point keeps the neighbors that it has without noise, so that channel and
    channel are about the same pair of points. Panel "noise anew": neighbors are searched again.
    Normals and FPFH come from a new search in both. A feature with channels of several units has
    one curve for each unit, and one for all of its channels.
    """
    search = search_neighbors(points, config)
    rest = describe(points, search, config)
    curves: defaultdict[tuple[str, str], list[float]] = defaultdict(list)
    for sigma in config.noise_sigmas:
        draw = torch.from_numpy(rng.standard_normal(points.shape)).to(points)
        noisy = points + sigma * draw
        anew = search_neighbors(noisy, config)
        kept = describe(noisy, Search(search.neighbor_index, anew.normal_index), config)
        fresh = describe(noisy, anew, config, names=("XYZ", "ΔXYZ", "RRI", "PPF")) | {
            "FPFH": kept["FPFH"]
        }
        for panel, after in (("noise", kept), ("noise anew", fresh)):
            for label, value in channel_error(rest, after).items():
                curves[panel, label].append(value)
    return dict(curves)


def unrelated(
    points: Float[Tensor, "n 3"], rng: np.random.Generator, config: StudyConfig
) -> Curves:
    """What the two measures say about features of two random points of the cloud at rest."""
    rest = describe(points, search_neighbors(points, config), config)
    other = torch.from_numpy(rng.permutation(len(points))).to(points.device)
    swapped = {name: values[other] for name, values in rest.items()}
    similar = _similarities({name: agreement(rest[name], swapped[name]) for name in rest})
    curves: Curves = {("unrelated", label): [value] for label, value in similar.items()}
    for label, value in channel_error(rest, swapped).items():
        curves["spread", label] = [value]
    return curves


def search_neighbors(points: Float[Tensor, "n 3"], config: StudyConfig) -> Search:
    """Nearest neighbors of each point of a cloud, from the cloud itself."""
    index, distance = knn(points, points, max(config.neighbors, config.normal_neighbors))
    near = torch.where(distance <= config.normal_radius, index, MISSING)
    return Search(index[:, : config.neighbors], near[:, : config.normal_neighbors])


def describe(
    points: Float[Tensor, "n 3"],
    search: Search,
    config: StudyConfig,
    *,
    rule: Orientation = "origin",
    names: Sequence[str] = tuple(UNITS),
) -> dict[str, Float[Tensor, "n ... c"]]:
    """Features `names` of each point and neighbor, with the normals oriented by `rule`.

    RRI has its center at the origin of the frame, wherever the cloud is.
    """
    neighbor_index, near = search
    normals = estimate_normals(points, neighbor_index=near, orientation=rule)
    radius, most = config.normal_radius, config.normal_neighbors
    compute: dict[str, Callable[[], Tensor]] = {
        "XYZ": lambda: xyz(points, neighbor_index),
        "ΔXYZ": lambda: delta_xyz(points, neighbor_index),
        "RRI": lambda: rri(points, neighbor_index, center=points.new_zeros(3)),
        "PPF": lambda: ppf(points, normals, neighbor_index),
        "FPFH": lambda: fpfh(points, normals, radius=radius, max_neighbors=most),
    }
    return {name: compute[name]() for name in names}


def agreement(before: Float[Tensor, "n ... c"], after: Float[Tensor, "n ... c"]) -> Agreement:
    """Inner products of each point's features, all its neighbors' channels one after the other."""
    before, after = before.flatten(1), after.flatten(1)
    return Agreement((before * after).sum(-1), before.square().sum(-1), after.square().sum(-1))


def cosine(*parts: Agreement, weights: Sequence[float] | None = None) -> float:
    """Mean cosine over the points, of the concatenation of the parts, each times √weight.

    Two zero vectors agree (1); a zero vector and another do not (0).

    >>> east, north = torch.tensor([[2.0, 0.0]]), torch.tensor([[0.0, 1.0]])
    >>> cosine(agreement(east, north)), cosine(agreement(east, north), agreement(north, north))
    (0.0, 0.3162277638912201)
    """
    scale = weights or [1.0] * len(parts)
    stacked = torch.stack([torch.stack(part) * w for w, part in zip(scale, parts, strict=True)])
    dot, before_sq, after_sq = stacked.sum(0)
    length = (before_sq * after_sq).sqrt()
    value = dot / torch.where(length > 0, length, 1.0)
    return float(torch.where((before_sq == 0) & (after_sq == 0), 1.0, value).mean())


def channel_error(
    before: Mapping[str, Float[Tensor, "n ... c"]], after: Mapping[str, Float[Tensor, "n ... c"]]
) -> dict[str, float]:
    """Mean absolute difference per channel of each feature, and of its channels of one unit."""
    errors: dict[str, float] = {}
    for name in before:
        difference = (after[name] - before[name]).abs()
        errors[name] = float(difference.mean())
        if len(UNITS[name]) > 1:
            for unit, channels in UNITS[name].items():
                errors[f"{name} {unit}"] = float(difference[..., channels].mean())
    return errors


def _unoriented(points: Tensor, search: Search) -> dict[str, Tensor]:
    """PPF from normals whose signs mean nothing: as they are, and folded, which ignores signs."""
    index, near = search
    normals = estimate_normals(points, neighbor_index=near, orientation="none")
    return {
        "PPF (none)": ppf(points, normals, index),
        "PPF (none, folded)": ppf(points, normals, index, fold=True),
    }


def _similarities(parts: Mapping[str, Agreement]) -> dict[str, float]:
    """Mean cosine of each feature and of its concatenation with both kinds of coordinates."""
    values = {name: cosine(part) for name, part in parts.items()}
    for name in INVARIANT:
        joined = [parts[name], parts["XYZ"], parts["ΔXYZ"]]
        sizes = [float(part.before_sq.mean()) for part in joined]
        values[f"{name}+XYZ+ΔXYZ"] = cosine(*joined)
        values[f"{name}+XYZ+ΔXYZ (equal parts)"] = cosine(
            *joined, weights=[1 / size if size > 0 else 1.0 for size in sizes]
        )
    return values
