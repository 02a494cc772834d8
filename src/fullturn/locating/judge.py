"""Which pose of the model in a part of a scene is right, and how probably; or none of them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.locating.model import PreparedModel
from fullturn.locating.verify import FEATURES
from fullturn.pose.grid import NearestGrid
from fullturn.pose.planes import move_planes
from fullturn.pose.verdict import (
    load_weights,
    log_probabilities,
    merge_same,
    same_pose,
    verdict_inputs,
)

SAME_SURFACE = 0.05  # of the diameter: the farthest that a point of one placement is off the other
_COMPARED = 600  # points of the surface at least, where it has them
_APART = 0.2  # share of common points below which two poses are of two instances, not rivals


@dataclass(frozen=True, eq=False)
class Judged:
    """Distinct poses, the most probable first."""

    index: list[int]  # into the poses that were asked about
    pose: list[float]  # probability that the true pose is within 5° and 5 % of the radius of it
    surface: list[float]  # probability that the surface lies there, however the model is turned

    def at_most(self, limit: float) -> Judged:
        """All probabilities scaled alike, where the largest is above the limit."""
        scale = min(1.0, limit / max(*self.surface, 1e-9))
        return Judged(self.index, [scale * p for p in self.pose], [scale * p for p in self.surface])


def same_surface(
    T_scene_model: Float[Tensor, "k 4 4"],
    other: Float[Tensor, "l 4 4"],
    model: PreparedModel,
    model_grid: NearestGrid,
) -> Bool[Tensor, "k l"]:
    """Which placements are the same surface: all points within 5 % of the diameter, or one pose.

    So a turn of a symmetric model onto itself is the same, and one with its handle elsewhere isn't.
    """
    rows = slice(None, None, max(1, len(model.surface) // _COMPARED))
    points = model.surface[rows]
    between = rigid.invert(other)[None] @ T_scene_model[:, None]
    difference = model_grid.difference(move_planes(between.flatten(0, 1), points.T))
    # Points stand for all around them, half a spacing away.
    tolerance = SAME_SURFACE * model.diameter / model.radius + 0.5 * model.spacing
    far = difference.square().sum(0).amax(1).sqrt().view(between.shape[:2])
    return (far < tolerance) | same_pose(T_scene_model, other)


def judge(
    T_scene_model: Float[Tensor, "k 4 4"],
    features: Float[Tensor, "k f"],
    explained: Bool[Tensor, "k n"],
    model: PreparedModel,
    model_grid: NearestGrid,
) -> Judged:
    """Rank the poses of one part by the probability that the surface lies there.

    Poses that explain other points than the likeliest one does are no rivals of it: they may be
    those of another instance. A pose's probabilities are the sums over all that are the same as it
    (`merge_same`).
    """
    inputs = verdict_inputs(features.double())
    log_p = log_probabilities(inputs, load_weights("locate.safetensors", FEATURES))
    best = int(log_p[:-1].argmax())
    fewest = torch.minimum(explained.sum(1), explained[best].sum()).clamp_min(1)
    rival = (explained & explained[best]).sum(1) >= _APART * fewest
    rival[best] = True
    index = torch.nonzero(rival)[:, 0]
    p = torch.softmax(torch.cat([log_p[index], log_p[-1:]]), 0)[:-1]
    T = T_scene_model[index]
    surface = same_surface(T, T, model, model_grid)
    surface |= surface.T.clone()
    total = (surface.to(p.dtype) @ p).clamp_max(1.0)
    # The likeliest surface, and on it the likeliest pose.
    rows, own = merge_same(p, same_pose(T, T), before=total)
    return Judged(index[rows].tolist(), own, total[rows].tolist())
