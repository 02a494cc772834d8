"""How unlike the descriptors of two points are: the energy of matching them (G5)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

# The terms Θ = [Ω, Λ1, …] of a cloud's points, each with channels of its own.
Terms = Sequence[Float[Tensor, "b _ _"]]


class FusedEnergy(nn.Module):
    """One linear map of all terms together, then one distance: |W Θ_i − W Θ_j|² / √width (G5).

    `channels` are those of the terms. W has no bias: it would cancel.
    """

    def __init__(self, channels: Sequence[int], *, width: int = 128) -> None:
        super().__init__()
        self.fuse = nn.Linear(sum(channels), width, bias=False)

    def forward(self, source_terms: Terms, target_terms: Terms) -> Float[Tensor, "b n m"]:
        source, target = (self.fuse(torch.cat(list(x), -1)) for x in (source_terms, target_terms))
        # The division by √width happens to the few rows instead of all their pairs.
        factor = source.shape[-1] ** -0.25
        return squared_distances(factor * source, factor * target)


class TermEnergy(nn.Module):
    """A weighted sum of one distance per term: Σ λ_t |Θt_i − Θt_j|² / √C_t (G5).

    The weights λ are learned in the log domain, so they stay positive; all of them start at 1.
    """

    def __init__(self, channels: Sequence[int]) -> None:
        super().__init__()
        self.channels = tuple(channels)
        self.log_weights = nn.Parameter(torch.zeros(len(self.channels)))

    def forward(self, source_terms: Terms, target_terms: Terms) -> Float[Tensor, "b n m"]:
        # λ|x − y|² = |√λ x − √λ y|²: the scaled terms side by side need one distance.
        sizes = torch.tensor(self.channels).to(self.log_weights)
        factors = ((self.log_weights - sizes.log() / 2) / 2).exp()
        source, target = (
            torch.cat([factor * term for factor, term in zip(factors, terms, strict=True)], -1)
            for terms in (source_terms, target_terms)
        )
        return squared_distances(source, target)


def squared_distances(
    source: Float[Tensor, "b n c"], target: Float[Tensor, "b m c"]
) -> Float[Tensor, "b n m"]:
    """All squared distances between the rows of two sets, by one product of matrices.

    |x − y|² = [x, |x|², 1] · [−2y, 1, |y|²]. Rounding errs by some ε (|x|² + |y|²), below zero too.

    >>> squared_distances(torch.eye(2)[None], torch.eye(2)[None])
    tensor([[[0., 2.],
             [2., 0.]]])
    """
    source_sq, target_sq = (x.square().sum(-1, keepdim=True) for x in (source, target))
    left = torch.cat([source, source_sq, torch.ones_like(source_sq)], -1)
    right = torch.cat([-2 * target, torch.ones_like(target_sq), target_sq], -1)
    return left @ right.mT
