"""A network over what every keypoint says of a pose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from fullturn.nn.packaged import load_packaged

_LARGEST = 5.0  # standard deviations of a signal; beyond it, nothing was seen in the fit


@dataclass(frozen=True)
class EvidenceNetConfig:
    """What goes in, and the width."""

    signals: tuple[str, ...]
    compared: tuple[str, ...]  # signals, of each point, held against its least among the rivals
    width: int = 32
    heads: int = 8  # of the attention over points


class EvidenceNet(nn.Module):
    """One number for each pose: how much all points together speak for it.

    1. Each point's signals, and how much larger than under the best rival some of them are, go
       through a small perceptron.
    2. Its outputs are averaged over the points of each cloud, by area (as in Qi et al., PointNet,
       CVPR 2017, with means for maxima); and, as a few points can decide, some sums of them once
       more by area and weights of their own (attention as in Ilse et al., ICML 2018).
    3. A second perceptron over the mean and the difference of both clouds, and how far these lie
       below the largest among the rivals.

    It knows no order of points, poses or clouds.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self, config: EvidenceNetConfig) -> None:
        super().__init__()
        self.config = config
        count, width = len(config.signals), config.width
        self.register_buffer("mean", torch.zeros(count))
        self.register_buffer("deviation", torch.ones(count))
        self._compared = [config.signals.index(name) for name in config.compared]
        self.point = nn.Sequential(
            nn.Linear(count + len(config.compared), width),
            nn.ReLU(),
            nn.Linear(width, width),
            nn.ReLU(),
        )
        self.attention = nn.Linear(width, config.heads, bias=False)
        self.value = nn.Linear(width, config.heads)
        self.pose = nn.Sequential(
            nn.Linear(4 * (width + config.heads), width), nn.Tanh(), nn.Linear(width, 1, bias=False)
        )

    def forward(
        self,
        signals: Float[Tensor, "k 2 m s"],
        area: Float[Tensor, "k 2 m"],
        pair: Int[Tensor, " k"] | None = None,
    ) -> Float[Tensor, " k"]:
        """Both clouds' points under each pose; points of no area are not there.

        `pair` says which pair of clouds a pose is of (None: all of one); rivals are of one pair.
        """
        compared = signals[..., self._compared].abs()
        standard = ((signals - self.mean) / self.deviation).clamp(-_LARGEST, _LARGEST)
        above = compared - _among_rivals(compared, pair, "amin")
        of_point = self.point(torch.cat([standard, above], -1))
        source, target = self._pooled(of_point, area).unbind(1)
        both = torch.cat([(source + target) / 2, (source - target).abs()], -1)
        below = both - _among_rivals(both, pair, "amax")
        return self.pose(torch.cat([both, below], -1))[:, 0]

    def _pooled(
        self, of_point: Float[Tensor, "k 2 m w"], area: Float[Tensor, "k 2 m"]
    ) -> Float[Tensor, "k 2 p"]:
        total = area.sum(-1, keepdim=True).clamp_min(1e-6)
        mean = (area.unsqueeze(-2) @ of_point)[..., 0, :] / total
        weight = (self.attention(of_point) + area.clamp_min(1e-9).log().unsqueeze(-1)).softmax(-2)
        return torch.cat([mean, (weight * self.value(of_point)).sum(-2)], -1)


def _among_rivals(
    value: Float[Tensor, " k *rest"],
    pair: Int[Tensor, " k"] | None,
    extreme: Literal["amin", "amax"],
) -> Float[Tensor, " _ *rest"]:
    """The least or the largest of each value among the poses of one pair; a row, or one for all."""
    if pair is None:
        return torch.amin(value, 0, True) if extreme == "amin" else torch.amax(value, 0, True)
    row = pair.view(-1, *(1,) * (value.dim() - 1)).expand_as(value)
    found = value.new_empty((int(pair.max()) + 1, *value.shape[1:]))
    return found.scatter_reduce_(0, row, value, extreme, include_self=False)[pair]


@cache
def load_evidence_net() -> EvidenceNet | None:
    """The network with the weights in the package, in evaluation mode; None where they are missing.

    Raises:
        ReadError: weights of another network.
    """
    return load_packaged(
        "evidence.safetensors",
        lambda config: EvidenceNet(
            EvidenceNetConfig(
                tuple(config["signals"]),
                tuple(config["compared"]),
                config["width"],
                config["heads"],
            )
        ),
    )
