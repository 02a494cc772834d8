"""Hierarchical Graphical Modeling (HGM): descriptors of the points of each cloud on its own."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from fullturn.nn.clouds import CloudBatch
from fullturn.nn.config import GMCNetConfig
from fullturn.nn.graphs import build_graphs
from fullturn.nn.layers import SharedLayer
from fullturn.nn.rows import unpack
from fullturn.nn.tpt import PointTransformer, PointwiseBlock


class Encoder(nn.Module):
    """The descriptor G4, Θ = [Ω, Λ1, Λ2, Λ3], as a tuple of its terms.

    1. Feature graphs of three levels, without anything learned.
    2. Ω, the unary term: RI features of the neighbors → 64 → C0; nothing else enters.
    3. Node features: RI branch (64) beside the spatial one (64), → 128 → C1.
    4. Λ1: TPT around every point.
    5. Λ2: TPT around N/D1 points on [Ω, Λ1], then → 64 → C2.
    6. Λ3: TPT around N/D2 points on level 2's features, then → 16 → C3.
    7. Λ2 and Λ3 back at every point, by inverse distance; padding is zero.

    Clouds do not meet: a cloud has the same descriptors in any batch once the network is in
    evaluation mode, and they can be kept and matched against many others.

    To compile it, compile the blocks: ``encoder.level1.compile()``. The graphs are not for a
    compiler: where a normal hangs on rounding, it would be another one.
    """

    def __init__(self, config: GMCNetConfig) -> None:
        super().__init__()
        self.config = config
        k1, k2, k3 = config.graph_neighbors
        c0, c1, c2, c3 = config.channels
        ri_width = 33 if config.features == "fpfh" else k1 * config.ri_channels
        self.ri = SharedLayer(ri_width, 64)
        self.unary = SharedLayer(64, c0)
        self.beside = SharedLayer(ri_width if config.rif_only else 6 * k1, 64)
        self.nodes = nn.Sequential(SharedLayer(128, 128), SharedLayer(128, c1))
        self.level1 = _block(config, c1, c1 // 2, c1, k=k1)
        if config.hgm:
            self.level2 = _block(config, c0 + c1, (c0 + c1) // 2, 128, k=k2)
            self.after2 = nn.Sequential(SharedLayer(128, 64), SharedLayer(64, c2))
            self.level3 = _block(config, c2, c2 // 2, 32, k=k3)
            self.after3 = nn.Sequential(SharedLayer(32, 16), SharedLayer(16, c3))

    def forward(self, clouds: CloudBatch) -> tuple[Float[Tensor, "b n _"], ...]:
        # 1.
        graphs = build_graphs(clouds, self.config)
        # 2.
        ri = self.ri(graphs.ri)
        unary = self.unary(ri)
        # 3.
        beside = self.beside(graphs.ri if graphs.spatial is None else graphs.spatial)
        nodes = self.nodes(torch.cat([ri, beside], dim=-1))
        # 4.
        smooth1 = self.level1(nodes, graphs.levels[0])
        terms = [unary, smooth1]
        if self.config.hgm:
            # 5.
            smooth2 = self.level2(torch.cat(terms, dim=-1), graphs.levels[1])
            smooth2 = self.after2(smooth2)
            # 6.
            smooth3 = self.after3(self.level3(smooth2, graphs.levels[2]))
            # 7.
            back2, back3 = graphs.back
            terms += [back2(smooth2), back3(smooth3)]
        return tuple(unpack(term, clouds.mask) for term in terms)


def _block(config: GMCNetConfig, c_in: int, mid: int, c_out: int, *, k: int) -> nn.Module:
    if not config.tpt:
        return PointwiseBlock(c_in, mid, c_out)
    return PointTransformer(c_in, mid, c_out, k=k, relation_channels=config.relation_channels)
