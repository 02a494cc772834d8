"""What tells a right pose of a model in a scan from a wrong one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.locating.model import PreparedModel
from fullturn.locating.part import Part
from fullturn.locating.planes import Plane
from fullturn.locating.visible import best_views, view_directions
from fullturn.pose.grid import NearestGrid
from fullturn.pose.planes import move_planes, turn_planes

# h is the point spacing of the part, d the distance to the nearest point of the other side; "near"
# means d < 1.5 h. "Part": those of its points that the model could reach at the pose. "Seen": the
# surface that the sensor sees at the pose, or, where nobody knows it, the view that fits best.
FEATURES = (
    "part_one",  # log of the mean of min(d/h, 1)² over the part
    "part_three",  # ... of min(d/h, 3)²
    "part_plane",  # near: log of the mean of min(height/h, 1)², height above the tangent plane
    "part_smooth",  # near: ... of the mean height of the neighborhood, which noise hardly changes
    "part_near",  # share of the part that is near
    "part_far",  # share of the part beyond 4 h
    "part_behind",  # share that is near a surface that faces away from the eye
    "part_normals",  # near: mean of 1 − |cos| of the two normals
    "seen_one",  # the same over what is seen of the surface
    "seen_three",
    "seen_plane",
    "seen_near",
    "seen_far",
    "seen_normals",
    "seen_union",  # intersection over union of what is seen and what has partners
    "past",  # share of what is seen that the sensor saw past, to something behind
    "empty",  # share in front of nothing that the sensor returned
    "hidden",  # share behind something else
    "sight_known",  # 1 where the sensor's place is known
    "below",  # share of the whole surface that lies below a large plane
    "below_depth",  # how deep its lowest point lies below, at most 0.5
    "log_points",  # of the part, natural logarithm
    "seen_share",  # of the whole surface
)

ON_MODEL = 2.0  # spacings from the model's surface up to which a point lies on it


@dataclass(frozen=True, eq=False)
class Measured:
    """Poses of one part, and what was measured of each."""

    features: Float[Tensor, "k f"]  # columns: FEATURES
    explained: Bool[Tensor, "k n"]  # points of the part that lie on the model
    visible_share: Float[Tensor, " k"]  # of the model's surface that lies on the scene


def measure(
    T_scene_model: Float[Tensor, "k 4 4"],
    part: Part,
    model: PreparedModel,
    model_grid: NearestGrid,
    planes: Sequence[Plane],
) -> Measured:
    """One row of `FEATURES` per pose of the model in the part's frame; float32."""
    T, h, k = T_scene_model, part.spacing, len(T_scene_model)
    R = T[:, :3, :3]
    surface = move_planes(T, model.surface.T)
    difference, scene_normal = part.grid.nearest(surface)
    surface = surface.permute(1, 2, 0)
    d = difference.square().sum(0).sqrt() / h
    sight, viewpoint = part.sight, part.viewpoint
    if sight is None or viewpoint is None:
        reach = (1 - (d / 3.0) ** 2).clamp_min(0)
        view = best_views(reach, model.area, model.seen)
        seen, direction = model.seen[view], model.directions[view]
    else:
        seen = sight.visible(T, model.surface, model.normals)
        direction = view_directions(T, viewpoint)
    weight = model.area * seen
    weight = weight / weight.sum(1, keepdim=True).clamp_min(1e-6)
    height = (difference * scene_normal).sum(0) / h
    cosine = (turn_planes(R, model.normals.T) * scene_normal).sum(0).abs()
    found = _side("seen", d, height, cosine, weight)
    has_partner = (d < 1.5) * model.area
    union = (has_partner + model.area * seen).clamp_max(model.area).sum(1)
    found["seen_union"] = (has_partner * seen).sum(1) / union.clamp_min(1e-6)

    local = move_planes(rigid.invert(T), part.points.T)
    difference, normal = model_grid.nearest(local)
    distance = difference.square().sum(0).sqrt() / h
    within = local.norm(dim=0) < 1.0 + 2.0 * h
    part_weight = part.area * within
    part_weight = part_weight / part_weight.sum(1, keepdim=True).clamp_min(1e-6)
    height = (difference * normal).sum(0) / h
    cosine = (normal * turn_planes(R.mT, part.normals.T)).sum(0).abs()
    behind = (distance < 1.5) & ((normal * direction.T.unsqueeze(-1)).sum(0) < -0.1)
    found |= _side("part", distance, height, cosine, part_weight)
    found["part_behind"] = (behind * part_weight).sum(1)
    near = (distance < 1.5) * part_weight
    smooth = height.clamp(-1.5, 1.5)[:, part.neighbor].mean(-1)
    total = near.sum(1).clamp_min(1e-3)
    found["part_smooth"] = _log((near * smooth.square()).sum(1) / total)

    contradicted = ("past", "empty", "hidden")
    found |= dict.fromkeys((*contradicted, "sight_known"), T.new_zeros(k))
    if sight is not None:
        masks = sight.contradictions(surface, seen)
        found |= {
            name: (mask * weight).sum(1) for name, mask in zip(contradicted, masks, strict=True)
        }
        found["sight_known"] = T.new_ones(k)
    found["below"], found["below_depth"] = _below(surface, part, planes)
    found["log_points"] = T.new_full((k,), math.log(len(part.points)))
    found["seen_share"] = (model.area * seen).sum(1) / model.area.sum()
    visible = (has_partner * seen).sum(1) / model.area.sum()
    columns = [found[name] for name in FEATURES]
    return Measured(torch.stack(columns, 1), distance < ON_MODEL, visible)


def _side(
    side: str, d: Tensor, height: Tensor, cosine: Tensor, weight: Tensor
) -> dict[str, Tensor]:
    """What both sides are asked, named by `FEATURES`."""
    near = (d < 1.5) * weight
    total = near.sum(1).clamp_min(1e-3)
    plane = (near * height.abs().clamp_max(1).square()).sum(1) / total
    return {
        f"{side}_one": _log((d.clamp_max(1).square() * weight).sum(1)),
        f"{side}_three": _log((d.clamp_max(3).square() * weight).sum(1)),
        f"{side}_plane": _log(plane),
        f"{side}_near": near.sum(1),
        f"{side}_far": ((d > 4) * weight).sum(1),
        f"{side}_normals": (near * (1 - cosine)).sum(1) / total,
    }


def _log(value: Tensor) -> Tensor:
    return (value + 1e-4).log()


def _below(surface: Tensor, part: Part, planes: Sequence[Plane]) -> tuple[Tensor, Tensor]:
    share, deepest = surface.new_zeros(len(surface)), surface.new_zeros(len(surface))
    for plane in planes:
        offset = plane.offset - float(part.middle.to(plane.normal) @ plane.normal)
        depth = offset - surface @ plane.normal.to(surface)
        margin = plane.thickness + 0.5 * part.spacing
        share = torch.maximum(share, (depth > margin).to(share).mean(1))
        deepest = torch.maximum(deepest, depth.amax(1).clamp(0.0, 0.5))
    return share, deepest
