"""How strict the matching should be, predicted from both clouds."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F


class TemperatureNet(nn.Module):
    """A PointNet over two posed clouds that predicts α and β of the score β(α − E), both positive.

    The parameter network of RPMNet (Yew and Lee, CVPR 2020), 0.81 M parameters:
    1. all points of both clouds as one set, with a fourth coordinate: 0 source, 1 target;
    2. shared per point: linear maps to 64, 64, 64, 128, 1024 channels, each with group
       normalization and ReLU;
    3. the maximum over all points;
    4. linear maps to 512 and 256 channels, with group normalization and ReLU, then to 2;
    5. softplus.

    It sees raw coordinates, so α and β are not invariant to motions.
    """

    def __init__(self) -> None:
        super().__init__()
        self.shared = nn.ModuleList(
            _Layer(a, b, groups=g)
            for a, b, g in [(4, 64, 8), (64, 64, 8), (64, 64, 8), (64, 128, 8), (128, 1024, 16)]
        )
        self.pooled = nn.ModuleList(_Layer(a, b, groups=16) for a, b in [(1024, 512), (512, 256)])
        self.last = nn.Linear(256, 2)

    def forward(
        self,
        source: Float[Tensor, "b n 3"],
        target: Float[Tensor, "b m 3"],
        source_mask: Bool[Tensor, "b n"],
        target_mask: Bool[Tensor, "b m"],
    ) -> tuple[Float[Tensor, " b"], Float[Tensor, " b"]]:
        """α and β of each pair."""
        # 1
        x = torch.cat([F.pad(source, (0, 1), value=0.0), F.pad(target, (0, 1), value=1.0)], 1)
        mask = torch.cat([source_mask, target_mask], 1)
        # 2
        for layer in self.shared:
            x = layer(x, mask)
        # 3: after a ReLU nothing is below 0
        x = (x * mask.unsqueeze(-1)).amax(1, keepdim=True)
        # 4
        for layer in self.pooled:
            x = layer(x, torch.ones_like(mask[:, :1]))
        # 5
        beta, alpha = F.softplus(self.last(x).squeeze(1)).unbind(-1)
        return alpha, beta


class _Layer(nn.Module):
    """Linear map, group normalization over the valid points, ReLU."""

    def __init__(self, channels_in: int, channels_out: int, *, groups: int) -> None:
        super().__init__()
        self.linear = nn.Linear(channels_in, channels_out)
        self.norm = nn.GroupNorm(groups, channels_out)

    def forward(
        self, x: Float[Tensor, "b n c"], mask: Bool[Tensor, "b n"]
    ) -> Float[Tensor, "b n d"]:
        x = self.linear(x)
        # As nn.GroupNorm but for the padding; one affine map per channel in the end.
        share = (mask.to(x) / mask.sum(-1, keepdim=True)).unsqueeze(1)
        by_group = (self.norm.num_groups, -1)
        mean = (share @ x).unflatten(-1, by_group).mean(-1, keepdim=True)
        mean_sq = (share @ x.square()).unflatten(-1, by_group).mean(-1, keepdim=True)
        variance = (mean_sq - mean.square()).clamp_min(0.0)
        scale = self.norm.weight.view(by_group) * (variance + self.norm.eps).rsqrt()
        shift = self.norm.bias.view(by_group) - mean * scale
        return torch.addcmul(shift.flatten(-2), x, scale.flatten(-2)).relu_()
