"""GMCNet, the paper's network: two clouds in, one pose out, in one shot."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor, nn

from fullturn.matching.energy import FusedEnergy, TermEnergy, Terms
from fullturn.matching.sinkhorn import sinkhorn
from fullturn.nn.clouds import CloudBatch
from fullturn.nn.config import GMCNetConfig
from fullturn.nn.encoder import Encoder
from fullturn.nn.temperature import TemperatureNet
from fullturn.pose.soft import soft_pose


@dataclass(frozen=True, eq=False)
class Registered:
    """What the network says of a batch of pairs.

    The way back is an estimate of its own, from the same scores: Sinkhorn ends with the other
    cloud's points, and the soft targets lie in the other cloud. It is computed when asked for.
    """

    T_target_source: Float[Tensor, "b 4 4"]
    matching: Float[Tensor, "b n m"]  # m*, from source to target
    scores: Float[Tensor, "b n m"]  # β(α − E), before Sinkhorn
    source: CloudBatch
    target: CloudBatch
    sinkhorn_rounds: int

    @cached_property
    def matching_back(self) -> Float[Tensor, "b m n"]:
        """m* from target to source."""
        return sinkhorn(
            self.scores.mT.contiguous(),
            self.target.mask,
            self.source.mask,
            rounds=self.sinkhorn_rounds,
        )

    @cached_property
    def T_source_target(self) -> Float[Tensor, "b 4 4"]:
        """The pose of the way back; near the inverse of `T_target_source` for a trained net."""
        return soft_pose(self.matching_back, self.target.points, self.source.points)


class GMCNet(nn.Module):
    """Pose of partial clouds from soft correspondences between descriptors (Pan, Cai, Liu, IJCV).

    1. descriptors Θ of each cloud alone, by the shared encoder (G4);
    2. energies between all points of both (G5);
    3. α and β, fixed or predicted from both clouds, turn them into scores β(α − E);
    4. Sinkhorn with slack: the matching m*;
    5. confidences, soft targets and the weighted Kabsch pose (G6–G8).

    Descriptors don't depend on the other cloud: `encode` a cloud once, `match` it many times.
    """

    def __init__(self, config: GMCNetConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = Encoder(config)
        energy = FusedEnergy if config.matching == "fused" else TermEnergy
        self.energy = energy(config.term_channels)
        self.temperature = TemperatureNet() if config.temperature == "predicted" else None

    def forward(self, source: CloudBatch, target: CloudBatch) -> Registered:
        """Register each source to its target; the way back is computed when asked for."""
        # 1
        source_terms, target_terms = self._encode_both(source, target)
        # 2, 3
        scores = self.score(source, target, source_terms, target_terms)
        # 4
        matching = sinkhorn(scores, source.mask, target.mask, rounds=self.config.sinkhorn_rounds)
        # 5
        T_target_source = soft_pose(matching, source.points, target.points)
        return Registered(
            T_target_source, matching, scores, source, target, self.config.sinkhorn_rounds
        )

    def encode(self, clouds: CloudBatch) -> tuple[Float[Tensor, "b n _"], ...]:
        """The terms [Ω, Λ1, …] of each point (step 1), which depend on its own cloud alone."""
        terms: tuple[Tensor, ...] = self.encoder(clouds)
        return terms

    def score(
        self, source: CloudBatch, target: CloudBatch, source_terms: Terms, target_terms: Terms
    ) -> Float[Tensor, "b n m"]:
        """The scores β(α − E) of all pairs of points (steps 2 and 3)."""
        energies = self.energy(source_terms, target_terms)
        if self.temperature is None:
            alpha = energies.new_tensor(self.config.alpha)
            beta = energies.new_tensor(self.config.beta)
        else:
            predicted = self.temperature(source.points, target.points, source.mask, target.mask)
            alpha, beta = (x[:, None, None] for x in predicted)
        return torch.addcmul(beta * alpha, beta, energies, value=-1)

    def match(
        self, source: CloudBatch, target: CloudBatch, source_terms: Terms, target_terms: Terms
    ) -> Float[Tensor, "b n m"]:
        """The matching m* of clouds that are encoded already (steps 2 to 4)."""
        scores = self.score(source, target, source_terms, target_terms)
        return sinkhorn(scores, source.mask, target.mask, rounds=self.config.sinkhorn_rounds)

    def _encode_both(
        self, source: CloudBatch, target: CloudBatch
    ) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        # As one batch: in training, both sides of a pair are then normalized alike.
        both = self.encode(CloudBatch.join([source, target]))
        pairs, n = source.mask.shape
        m = target.mask.shape[1]
        return tuple(x[:pairs, :n] for x in both), tuple(x[pairs:, :m] for x in both)
