"""Which part of the model's surface a sensor sees at a pose, from the views that were prepared."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from fullturn.geometry import rigid


def view_directions(
    T_scene_model: Float[Tensor, "k 4 4"], viewpoint: Float[Tensor, "3"]
) -> Float[Tensor, "k 3"]:
    """From the model's middle to the eye, in the model's frame."""
    eye = rigid.apply(rigid.invert(T_scene_model), viewpoint.to(T_scene_model)[None])[:, 0]
    return torch.nn.functional.normalize(eye, dim=1)


def nearest_views(
    direction: Float[Tensor, "k 3"], directions: Float[Tensor, "v 3"]
) -> Int[Tensor, " k"]:
    """The prepared view that is nearest to each direction."""
    return (direction @ directions.T).argmax(1)


def best_views(
    explained: Float[Tensor, "k m"], area: Float[Tensor, " m"], seen: Bool[Tensor, "v m"]
) -> Int[Tensor, " k"]:
    """The view that agrees best with which of the surface finds partners in the scene, in [0, 1].

    Where nobody knows the viewpoint: the view with the largest intersection over union of what it
    sees and what is explained, counted in area.
    """
    weighted = explained * area
    visible = (seen * area).sum(1)
    both = weighted @ seen.to(weighted).T
    either = visible + weighted.sum(1, keepdim=True) - both
    return (both / either.clamp_min(1e-9)).argmax(1)
