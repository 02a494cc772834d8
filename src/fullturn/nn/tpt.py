"""Transformation-robust Point Transformer (TPT): attention inside feature graphs."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from fullturn.geometry.neighbors import gather
from fullturn.nn.config import SHARE
from fullturn.nn.graphs import Level

# Values of edges that are worked on at once on a CPU: they then stay in its cache. A compiled block
# has loops of its own.
_VALUES_AT_ONCE = 1 << 17


class PointTransformer(nn.Module):
    """Features of the centers of a level from those of their neighbors (the paper's TPT).

    1. x ← ReLU(W0 x); of every point key ξ(x_j) and value β(x_j), of every center query ζ(x_i).
       Maps of single points come before they are gathered as neighbors: k times less work.
    2. η(ρ_ij): two linear maps without bias and a ReLU between.
    3. G1: δ_i = [ζ(x_i) − ξ(x_j) + η(ρ_ij)] of all k neighbors, one after the other in the order of
       their distance.
    4. G2: α_i = softmax_j(γ(δ_i)), each weight shared by 8 groups of channels: channel c of `mid`
       has weight c mod (mid/8).
    5. G3: x_i' = W ReLU(Σ_j (β(x_j) + η(ρ_ij)) ⊙ α_ij) + x_i.
    """

    def __init__(self, c_in: int, mid: int, c_out: int, *, k: int, relation_channels: int) -> None:
        super().__init__()
        weights = mid // SHARE
        self.mid = mid
        self.input = nn.Linear(c_in, c_out)  # W0
        self.query = nn.Linear(c_out, mid)  # ζ
        self.key_value = nn.Linear(c_out, 2 * mid)  # ξ, then β
        self.embed = nn.Sequential(  # η
            nn.Linear(relation_channels, mid, bias=False),
            nn.ReLU(inplace=True),
            nn.Linear(mid, mid, bias=False),
        )
        self.attend = nn.Sequential(  # γ
            nn.Linear(k * mid, weights, bias=False),
            nn.ReLU(inplace=True),
            nn.Linear(weights, k * weights),
        )
        self.output = nn.Linear(mid, c_out)  # W

    def forward(self, x: Float[Tensor, "n c_in"], level: Level) -> Float[Tensor, "m c_out"]:
        # 1.
        x = torch.relu_(self.input(x))
        key_value = self.key_value(x)
        if level.centers is not None:
            x = x.index_select(0, level.centers)
        query = self.query(x)
        # 2. to 5., in parts.
        rows = len(query)
        if query.device.type == "cpu" and not torch.compiler.is_compiling():
            rows = max(1, _VALUES_AT_ONCE // (level.neighbors.shape[1] * self.mid))
        edges = _edges(key_value, level.neighbors, rows)
        parts = zip(query.split(rows), edges, level.relation.split(rows), strict=True)
        gathered = [self._gathered(*part) for part in parts]
        return self.output(torch.relu_(torch.cat(gathered))) + x

    def _gathered(
        self,
        query: Float[Tensor, "m c"],
        key_value: Float[Tensor, "m k 2*c"],
        relation: Float[Tensor, "m k r"],
    ) -> Float[Tensor, "m c"]:
        key, value = key_value.split(self.mid, dim=-1)
        embedding = self.embed(relation)
        delta = query[:, None] - key + embedding
        weights = self.attend(delta.flatten(1)).unflatten(1, (relation.shape[1], 1, -1)).softmax(1)
        return ((value + embedding).unflatten(-1, (SHARE, -1)) * weights).sum(1).flatten(1)


class PointwiseBlock(nn.Module):
    """In place of a transformer, where its effect is studied: no word from the neighbors.

    x_i' = W2 ReLU(W1 x_i) + x_i with x_i ← ReLU(W0 x_i), of the transformer's widths.
    """

    def __init__(self, c_in: int, mid: int, c_out: int) -> None:
        super().__init__()
        self.input = nn.Linear(c_in, c_out)
        self.hidden = nn.Linear(c_out, mid)
        self.output = nn.Linear(mid, c_out)

    def forward(self, x: Float[Tensor, "n c_in"], level: Level) -> Float[Tensor, "m c_out"]:
        if level.centers is not None:
            x = x.index_select(0, level.centers)
        x = torch.relu_(self.input(x))
        return self.output(torch.relu_(self.hidden(x))) + x


def _edges(
    values: Float[Tensor, "n c"], neighbors: Int[Tensor, "m k"], rows: int
) -> Iterable[Float[Tensor, "_ k c"]]:
    """The values of the neighbors of some centers after another."""
    if torch.is_grad_enabled():
        # All at once: the gradient of each part by itself would be as large as all the values.
        return gather(values, neighbors).split(rows)
    return (gather(values, some) for some in neighbors.split(rows))
