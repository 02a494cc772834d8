"""The default method's descriptor network: histograms of the surface, and what lies around."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional

from fullturn.features.surface import (
    between_ramps,
    distances,
    ramp_starts,
    ramps,
    shell_counts,
    shell_position,
)
from fullturn.geometry.step import unit_step
from fullturn.nn.packaged import load_packaged


@dataclass(frozen=True)
class SurfaceNetConfig:
    """Sizes of the network. Lengths are in point spacings."""

    radius: float = 14.0  # of a point's surroundings
    power: float = 0.7  # shells are narrower near the point
    shells: int = 6
    bins: int = 6
    context_shells: int = 4
    hidden: int = 128
    context: int = 48
    wide: int = 192
    channels: int = 64  # of a descriptor


class SurfaceNet(nn.Module):
    """Descriptors of unit length, from points, centroid-oriented normals and areas.

    1. Counts of signed pair angles in shells (`shell_counts`): their square roots, and the log of
       the area in each shell.
    2. A small perceptron.
    3. Means of its output over shells of neighboring keypoints, and a second perceptron: a point
       learns what kinds of surface lie how far away.

    No order of neighbors, no coordinates, lengths in point spacings: what comes out depends on
    neither pose, scale nor the order of the points.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self, config: SurfaceNetConfig = SurfaceNetConfig()) -> None:
        super().__init__()
        self.config = config
        inputs = config.shells * (3 * config.bins + 1)
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("deviation", torch.ones(inputs))
        self.own = nn.Sequential(
            nn.Linear(inputs, config.hidden),
            nn.SiLU(),
            nn.Linear(config.hidden, config.channels),
            nn.SiLU(),
        )
        self.offered = nn.Linear(config.channels, config.context)
        self.both = nn.Sequential(
            nn.Linear(config.channels + config.context_shells * config.context, config.wide),
            nn.SiLU(),
            nn.Linear(config.wide, config.channels),
        )

    def forward(
        self,
        points: Float[Tensor, "n 3"],
        normals: Float[Tensor, "n 3"],
        area: Float[Tensor, " n"],
        keypoints: Int[Tensor, " k"],
        *,
        spacing: float,
    ) -> Float[Tensor, "k c"]:
        """Descriptors of the keypoints; `spacing` is that of all points, in their unit."""
        points = (points - points.mean(0)) / spacing
        distance = distances(points, keypoints)
        told = self.surroundings(points, normals, area, distance, keypoints)
        return self.describe(told, area[keypoints], distance.index_select(1, keypoints))

    def surroundings(
        self,
        points: Float[Tensor, "n 3"],
        normals: Float[Tensor, "n 3"],
        area: Float[Tensor, " n"],
        distance: Float[Tensor, "k n"],
        keypoints: Int[Tensor, " k"],
    ) -> Float[Tensor, "k i"]:
        """What the network is told of each keypoint; no weights of it take part."""
        config = self.config
        counts = shell_counts(
            points,
            normals,
            area,
            distance,
            keypoints,
            radius=config.radius,
            shells=config.shells,
            bins=config.bins,
            signed=True,
            power=config.power,
        )
        mass = counts.sum(-1, keepdim=True).div_(3).clamp_min_(1e-6)
        return torch.cat([(counts / mass).sqrt_().flatten(1), mass[..., 0].log()], 1)

    def describe(
        self,
        surroundings: Float[Tensor, "k i"],
        area: Float[Tensor, " k"],
        distance: Float[Tensor, "k k"],
    ) -> Float[Tensor, "k c"]:
        """Descriptors from surroundings; distances between the keypoints, in point spacings."""
        own = self.own((surroundings - self.mean) / self.deviation)
        offered = self.offered(own)
        around = _shell_means(
            offered, area, distance, radius=self.config.radius, shells=self.config.context_shells
        )
        return functional.normalize(self.both(torch.cat([own, around], -1)), dim=-1)


def _shell_means(
    values: Float[Tensor, "n c"],
    area: Float[Tensor, " n"],
    distance: Float[Tensor, "n n"],
    *,
    radius: float,
    shells: int,
) -> Float[Tensor, "n k"]:
    """Means of the neighbors' values over shells, each neighbor counting with its area."""
    n = len(distance)
    with torch.no_grad():
        weight = unit_step(radius - distance).mul_(area)
        shell = shell_position(distance, radius=radius, shells=shells, power=1.0)
        starts, share = ramp_starts(shells, like=shell), distance.new_empty(n, shells, n)
        ramps(shell, starts, out=share).mul_(weight.unsqueeze(1))
    summed = share.flatten(0, 1) @ torch.cat([values, values.new_ones(n, 1)], 1)
    summed = between_ramps(summed.view(n, shells, -1), 1)
    return (summed[..., :-1] / summed[..., -1:].clamp_min(1e-3)).flatten(1)


@cache
def load_surface_net() -> SurfaceNet | None:
    """The network with the weights in the package, in evaluation mode; None where they are missing.

    Raises:
        ReadError: weights of another network.
    """
    return load_packaged(
        "descriptor.safetensors", lambda config: SurfaceNet(SurfaceNetConfig(**config))
    )
