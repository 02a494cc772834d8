"""How alike the points of two clouds are, by what the surface around them is like."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.features.surface import surface_histogram
from fullturn.nn.surface import load_surface_net
from fullturn.pose.levels import LevelPair

# Of the keypoints on the two sides of a level: (k, l), greater is more alike; None where it can't
# be told.
Similarity = Callable[[LevelPair], Tensor | None]


def histogram_similarity(pair: LevelPair, *, radius: float = 12.0) -> Float[Tensor, "k l"]:
    """Inner products of handcrafted histograms out to `radius` point spacings."""
    source, target = (
        surface_histogram(
            level.points,
            level.normals,
            level.area,
            radius=radius * pair.spacing,
            keypoints=level.keypoints,
        )
        for level in (pair.source, pair.target)
    )
    return source @ target.T


def network_similarity(pair: LevelPair) -> Float[Tensor, "k l"] | None:
    """Inner products of the network's descriptors; None where its weights are missing."""
    network = load_surface_net()
    if network is None:
        return None
    network = network.to(pair.source.points.device)
    with torch.no_grad():
        source, target = (
            network(level.points, level.normals, level.area, level.keypoints, spacing=pair.spacing)
            for level in (pair.source, pair.target)
        )
    return source @ target.T
