"""A network that says how far the verdict can be trusted in a pair."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor, nn

from fullturn.nn.packaged import load_packaged

_LARGEST = 4.0  # standard deviations of an input; beyond it, nothing was seen in the fit


@dataclass(frozen=True)
class ConfidenceNetConfig:
    """What goes in, and the width."""

    inputs: tuple[str, ...]
    width: int = 16


class ConfidenceNet(nn.Module):
    """Two numbers for each pair: what its scores are multiplied by, and what "none" gets on top.

    The first is a temperature of the pair's own (as in Guo et al., "On calibration of modern
    neural networks", ICML 2017, where all share one). A fresh network changes nothing.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self, config: ConfidenceNetConfig) -> None:
        super().__init__()
        self.config = config
        count = len(config.inputs)
        self.register_buffer("mean", torch.zeros(count))
        self.register_buffer("deviation", torch.ones(count))
        self.hidden = nn.Linear(count, config.width)
        self.output = nn.Linear(config.width, 2)
        nn.init.zeros_(self.output.weight)
        nn.init.zeros_(self.output.bias)

    def forward(self, inputs: Float[Tensor, "*pairs f"]) -> Float[Tensor, "*pairs 2"]:
        """Both numbers of each pair."""
        standard = ((inputs - self.mean) / self.deviation).clamp(-_LARGEST, _LARGEST)
        factor, none = self.output(torch.tanh(self.hidden(standard))).unbind(-1)
        return torch.stack([factor.exp(), none], -1)


@cache
def load_confidence_net() -> ConfidenceNet | None:
    """The network with the weights in the package, in evaluation mode; None where they are missing.

    Raises:
        ReadError: weights of another network.
    """
    return load_packaged(
        "confidence.safetensors",
        lambda config: ConfidenceNet(ConfidenceNetConfig(tuple(config["inputs"]), config["width"])),
    )
