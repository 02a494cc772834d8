"""How alike the points of two clouds are, by what the surface around them is like."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from fullturn.features.surface import surface_histogram
from fullturn.nn.surface import load_surface_net
from fullturn.pose.levels import Level, LevelPair

# Of the keypoints on the two sides of a level: (k, l), greater is more alike; None where it can't
# be told.
Similarity = Callable[[LevelPair], Tensor | None]

_HISTOGRAM_RADIUS = 12.0  # point spacings


def histogram_similarity(pair: LevelPair) -> Float[Tensor, "k l"]:
    """Inner products of handcrafted histograms."""
    source, target = (
        histograms(level, level.keypoints, spacing=pair.spacing)
        for level in (pair.source, pair.target)
    )
    return source @ target.T


def network_similarity(pair: LevelPair) -> Float[Tensor, "k l"] | None:
    """Inner products of the network's descriptors; None where its weights are missing."""
    source, target = (
        network_descriptors(level, level.keypoints, spacing=pair.spacing)
        for level in (pair.source, pair.target)
    )
    return None if source is None or target is None else source @ target.T


def histograms(level: Level, rows: Int[Tensor, " k"], *, spacing: float) -> Float[Tensor, "k c"]:
    """Handcrafted histograms of some points, of unit length, out to 12 point spacings."""
    radius = _HISTOGRAM_RADIUS * spacing
    return surface_histogram(level.points, level.normals, level.area, radius=radius, keypoints=rows)


def network_descriptors(
    level: Level, rows: Int[Tensor, " k"], *, spacing: float
) -> Float[Tensor, "k c"] | None:
    """The network's descriptors of some points, of unit length; None without its weights."""
    network = load_surface_net()
    if network is None:
        return None
    with torch.no_grad():
        network = network.to(level.points.device)
        return network(level.points, level.normals, level.area, rows, spacing=spacing)
