"""The map that all parts of the network share."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn


class SharedLayer(nn.Module):
    """ReLU(BatchNorm(W x)) of each row on its own.

    Rows are points and never padding, so the statistics of a batch are those of its points.
    """

    def __init__(self, c_in: int, c_out: int) -> None:
        super().__init__()
        self.linear = nn.Linear(c_in, c_out, bias=False)
        self.norm = nn.BatchNorm1d(c_out)

    def forward(self, x: Float[Tensor, "t c_in"]) -> Float[Tensor, "t c_out"]:
        norm = self.norm
        if self.training or norm.running_mean is None or norm.running_var is None:
            return torch.relu_(norm(self.linear(x)))
        # With fixed statistics the normalization is part of the linear map.
        scale = norm.weight * (norm.running_var + norm.eps).rsqrt()
        bias = norm.bias - norm.running_mean * scale
        return torch.relu_(nn.functional.linear(x, self.linear.weight * scale[:, None], bias))
