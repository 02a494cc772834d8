"""The default method: many hypotheses, refined together, and a verdict between them."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.geometry.cloud import Cloud
from fullturn.methods.base import Estimate, Method, Traits
from fullturn.pose.decide import find_and_judge
from fullturn.pose.fine import refine_fine
from fullturn.pose.levels import LevelPair
from fullturn.pose.search import LIMIT_EDGE_RAD, SearchConfig
from fullturn.pose.symmetry import symmetry_of_poses
from fullturn.pose.verdict import limited, same_pose


@dataclass(frozen=True)
class ConsensusConfig:
    """What is reported, on top of how the search is done."""

    search: SearchConfig = field(default_factory=SearchConfig)
    least_probability: float = 0.01  # of an alternative
    most_alternatives: int = 9
    rival_share: float = 0.1  # of the answer's probability: what counts as evidence of symmetry


class Consensus(Method):
    """Search the full range of poses, verify, refine at full resolution. See docs/architecture.md.

    1. Finalists: distinct poses that fit, with what verification measured of each.
    2. Verdict: probabilities, ranking; where it doubts all of them, more finalists.
    3. Fine level: the answer is refined on all points.
    4. Symmetry: what the rivals have in common.
    """

    name = "consensus"
    summary = "matches, thousands of hypotheses, verification with calibrated probabilities"
    reference = "fullturn; second-order seeds after Chen et al., SC²-PCR, CVPR 2022"
    traits = Traits(limits_rotation=True)
    config: ClassVar[ConsensusConfig] = ConsensusConfig()

    def similarity(self, pair: LevelPair) -> Float[Tensor, "k l"] | None:
        """How alike the keypoints of both clouds are, by which matches are found.

        None: by the descriptor that the configuration names.
        """
        return None

    def estimate(
        self,
        source: Cloud,
        target: Cloud,
        *,
        rng: np.random.Generator,
        max_rotation_rad: float | None = None,
    ) -> Estimate:
        config = self.config
        begin = time.perf_counter()
        found, judged = find_and_judge(
            source,
            target,
            config=config.search,
            similarity=self.similarity,
            max_rotation_rad=max_rotation_rad,
        )
        kept = [
            (index, probability)
            for rank, (index, probability) in enumerate(
                zip(judged.index, judged.probability, strict=True)
            )
            if rank == 0 or probability >= config.least_probability
        ][: 1 + config.most_alternatives]
        T = found.T_target_source[[index for index, _ in kept]].clone()
        stated = torch.tensor([p for _, p in kept], dtype=T.dtype)
        probability, notes = limited(stated, source, target)
        judged_at = time.perf_counter()
        answer = refine_fine(T[0], source, target, start=2.0 * found.spacing)
        angle = float(rigid.rotation_angle_rad(answer[:3, :3]))
        if max_rotation_rad is None or angle <= max_rotation_rad + LIMIT_EDGE_RAD:
            T[0] = answer
        # Refined, the answer may have come to what was another pose.
        is_answer = same_pose(T[:1], T)[0]
        is_answer[0] = False
        probability[0] += probability[is_answer].sum()
        T, probability = T[~is_answer], probability[~is_answer]
        rivals = T[1:][probability[1:] >= config.rival_share * probability[0]]
        symmetry = symmetry_of_poses(T[0], rivals)
        end = time.perf_counter()
        verdict = judged_at - begin - sum(found.seconds.values())
        seconds = {**found.seconds, "verdict": verdict, "fine": end - judged_at}
        return Estimate(T, probability, symmetry, seconds, (*found.notes, *notes))


class ConsensusHistogram(Consensus):
    """The default method without its network: what it was before, and what it falls back on."""

    name = "consensus-histogram"
    summary = "the default method with handcrafted descriptors in place of the network"
    config = ConsensusConfig(search=SearchConfig(descriptor="histogram"))
