"""What training minimizes: the paper's loss (G9), and a loss on known correspondences."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.methods.learned.gmcnet import Registered
from fullturn.nn.clouds import CloudBatch


def paper_loss(
    registered: Registered,
    source: CloudBatch,
    target: CloudBatch,
    T_true: Float[Tensor, "b 4 4"],
    *,
    cycle: bool,
    inlier_weight: float = 0.01,
) -> Float[Tensor, ""]:
    """The loss that needs no correspondences, mean over the batch (G9).

    L = L_reg(XY) + ω L_inlier(XY), and with `cycle` the same of the way back:
    L_reg is the mean absolute difference of coordinates between source points moved by the
    predicted and by the true pose; L_inlier, of the matching, is mean(1 − column sums) +
    mean(1 − row sums). `T_true` is a `T_target_source`; ω is `inlier_weight`.
    """
    T_true = T_true.to(source.points)
    loss = registration_loss(registered.T_target_source, T_true, source)
    loss = loss + inlier_weight * inlier_loss(registered.matching, source, target)
    if cycle:
        T_back = rigid.invert(T_true)
        loss = loss + registration_loss(registered.T_source_target, T_back, target)
        loss = loss + inlier_weight * inlier_loss(registered.matching_back, target, source)
    return loss.mean()


def registration_loss(
    T_predicted: Float[Tensor, "b 4 4"], T_true: Float[Tensor, "b 4 4"], clouds: CloudBatch
) -> Float[Tensor, " b"]:
    """Mean absolute difference, over points and coordinates, of a cloud moved by two poses."""
    difference = rigid.apply(T_predicted, clouds.points) - rigid.apply(T_true, clouds.points)
    return _mean(difference.abs().mean(-1), clouds.mask)


def inlier_loss(
    matching: Float[Tensor, "b n m"], source: CloudBatch, target: CloudBatch
) -> Float[Tensor, " b"]:
    """Mean(1 − column sums) + mean(1 − row sums): how much mass the slack took."""
    rows = _mean(1.0 - matching.sum(-1), source.mask)
    columns = _mean(1.0 - matching.sum(-2), target.mask)
    return columns + rows


def correspondence_loss(
    registered: Registered,
    source: CloudBatch,
    target: CloudBatch,
    T_true: Float[Tensor, "b 4 4"],
    *,
    radius: float,
) -> Float[Tensor, ""]:
    """Cross-entropy of each point's true partner among all points of the other cloud and slack.

    The partner is the nearest point in the other cloud under the true pose; a point that has none
    within `radius` belongs to the slack, of score 0. From the scores before Sinkhorn, so each row
    and each column is one InfoNCE term; the mean over a cloud's points, then over both clouds and
    the batch.
    """
    scores = registered.scores
    moved = rigid.apply(T_true.to(source.points), source.points)
    both = source.mask.unsqueeze(-1) & target.mask.unsqueeze(-2)
    with torch.no_grad():
        # Products of matrices would lose the small distances, which are the ones that count.
        distance = torch.cdist(
            moved, target.points, compute_mode="donot_use_mm_for_euclid_dist"
        ).masked_fill_(~both, torch.inf)
    scores = scores.masked_fill(~both, -torch.inf)
    there = _cross_entropy(scores, distance, radius)
    back = _cross_entropy(scores.mT, distance.mT, radius)
    return (_mean(there, source.mask) + _mean(back, target.mask)).mean() / 2


def _cross_entropy(
    scores: Float[Tensor, "b n m"], distance: Float[Tensor, "b n m"], radius: float
) -> Float[Tensor, "b n"]:
    """−log softmax of the nearest within the radius, or of slack, in each row [scores, 0]."""
    nearest, partner = distance.min(-1)
    with_slack = torch.cat([scores, torch.zeros_like(scores[..., :1])], -1)
    partner = torch.where(nearest <= radius, partner, scores.shape[-1])
    chosen = with_slack.gather(-1, partner.unsqueeze(-1)).squeeze(-1)
    return with_slack.logsumexp(-1) - chosen


def _mean(values: Float[Tensor, "b n"], mask: Bool[Tensor, "b n"]) -> Float[Tensor, " b"]:
    """Mean over the valid entries of each row."""
    return (values * mask).sum(-1) / mask.sum(-1)
