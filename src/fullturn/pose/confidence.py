"""How sure a verdict may be, by what the pair as a whole shows.

A score says how much speaks for a pose. How far scores can be trusted differs from pair to pair:
it depends on how much of them is the evidence of the points, which was fit on the same pairs as the
verdict and knows less of others, on how many poses the best one was picked from, and on whether the
strongest rival is a half turn away, as on shapes that are nearly symmetric.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.nn.confidence import load_confidence_net
from fullturn.pose.verify import EVIDENCE, FEATURES

# Of the answer, the pose that most probability lies within the tolerance of, and its strongest
# rival, the one of which that holds among those that aren't the same pose.
INPUTS = (
    "rival_turn",  # angle between the two, in half turns
    "evidence",  # of the pose
    "evidence_below_most",  # the same, less the most that any pose has
    "evidence_above_rival",
    "log_poses",  # how many were measured
)
_EVIDENCE = FEATURES.index(*EVIDENCE)


def confidence_inputs(
    T_target_source: Float[Tensor, "k 4 4"],
    features: Float[Tensor, "k f"],
    same: Bool[Tensor, "k k"],
    log_p: Float[Tensor, " k+1"],
) -> Float[Tensor, " i"]:
    """`INPUTS` of one pair; without a rival, nothing lies between."""
    evidence = features[:, _EVIDENCE]
    share = same.to(log_p) @ log_p[:-1].exp()
    best = share.argmax()
    rivals = torch.where(same[best], -1.0, share)
    rival = best if bool(same[best].all()) else rivals.argmax()
    turn = rigid.rotation_angle_rad(
        T_target_source[best, :3, :3].T @ T_target_source[rival, :3, :3]
    )
    return torch.stack(
        [
            (turn / math.pi).to(evidence),
            evidence[best],
            evidence[best] - evidence.amax(),
            evidence[best] - evidence[rival],
            evidence.new_tensor(len(evidence)).log(),
        ]
    )


def tempered(
    log_p: Float[Tensor, "*pairs n"], trust: Float[Tensor, "*pairs 2"]
) -> Float[Tensor, "*pairs n"]:
    """Log probabilities of the finalists and, last, "none of them", at the pair's temperature."""
    factor, none = trust[..., :1], trust[..., 1:]
    scaled = log_p * factor
    return torch.cat([scaled[..., :-1], scaled[..., -1:] + none], -1).log_softmax(-1)


def trusted(
    T_target_source: Float[Tensor, "k 4 4"],
    features: Float[Tensor, "k f"],
    same: Bool[Tensor, "k k"],
    log_p: Float[Tensor, " k+1"],
) -> Float[Tensor, " k+1"]:
    """The verdict's log probabilities, as far as they can be trusted in this pair.

    Without evidence of the points, or the network's weights, as they are.
    """
    network = load_confidence_net()
    if network is None or bool(features[:, _EVIDENCE].isnan().any()):
        return log_p
    inputs = confidence_inputs(T_target_source, features, same, log_p)
    with torch.no_grad():
        trust = network.to(inputs.device)(inputs.float())
    return tempered(log_p, trust.to(log_p))
