"""What each keypoint says of a pose: the signals that the evidence network weighs."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import pad

from fullturn.geometry.sampling import evenly
from fullturn.nn.evidence import load_evidence_net
from fullturn.pose.contact import NEAR, Contact
from fullturn.pose.levels import Level, LevelPair
from fullturn.pose.verify import Likeness

# Of a point, its nearest point on the other cloud (partner) and the points around it. Heights are
# above the partner's tangent plane, signed by its normal; h is the point spacing.
SIGNALS = (
    "distance",  # to the partner, in h
    "reach",  # the same, normalized
    "height",  # in h
    "beside",  # distance along the tangent plane, in h
    "smooth",  # height between smoothed points, in h
    "smooth_near",  # its size, of near points
    "patch",  # mean of it over the 12 nearest points that are near
    "wide_patch",  # … the 48 nearest
    "patch_near",  # share of the 12 that is near
    "wide_patch_near",
    "wide_patch_normals",  # mean cosine of normals over the 48 that are near
    "normals",  # cosine
    "normals_unsigned",
    "near",
    "interior",
    "partner_interior",
    "rim",
    "partner_rim",
    "roughness",
    "partner_roughness",
    # Seen from the other cloud's sensor, where its place is known:
    "behind",  # depth behind the surface that it saw, in h
    "in_nothing",  # in front of nothing
    "outside",  # of its image
    "in_front",  # of what it saw
    "grazing",  # cosine of the line of sight and the normal
    "seen",  # whether its place is known
    "facing",  # cosine with the other cloud's mean normal
    "ahead",  # how far along that normal, from the other cloud's mean
    "from_middle",  # distance from that mean
    "alike",  # to the keypoint that it lies on
    "unlike",  # by how much another is more alike
    "keypoint",  # distance to that keypoint, in h
    "area",
)
COMPARED = ("distance", "smooth", "unlike")
_SMALL_PATCH, _PATCH = 12, 48
_HEARD = 200  # keypoints of each cloud: more of them cost time and say no more


@dataclass(frozen=True, eq=False)
class PointSignals:
    """Of the keypoints of both clouds, under every pose."""

    values: Float[Tensor, "k 2 m s"]  # columns: `SIGNALS`
    area: Float[Tensor, "k 2 m"]  # 0 where the smaller cloud has no such point


def evidence(signals: PointSignals) -> Float[Tensor, "k 1"]:
    """How much all points together speak for each pose; NaN without the network's weights."""
    network = load_evidence_net()
    if network is None:
        return signals.values.new_full((len(signals.values), 1), torch.nan)
    with torch.no_grad():
        return network.to(signals.values.device)(signals.values, signals.area)[:, None]


def point_signals(
    contacts: tuple[Contact, Contact],
    likenesses: tuple[Likeness, Likeness],
    fine: LevelPair,
    coarse: LevelPair,
) -> PointSignals:
    """Of the keypoints of the fine level, at which the contacts are.

    What descriptors say is known of the keypoints of the coarse level: the nearest of them speaks.
    """
    levels = ((fine.source, coarse.source), (fine.target, coarse.target))
    sides = [
        _signals_of_side(contact, likeness, level, described, fine.spacing, coarse.spacing)
        for contact, likeness, (level, described) in zip(contacts, likenesses, levels, strict=True)
    ]
    most = max(side.shape[1] for side in sides)
    values = torch.stack([pad(side, (0, 0, 0, most - side.shape[1])) for side in sides], 1)
    return PointSignals(values, values[..., SIGNALS.index("area")])


def _signals_of_side(
    contact: Contact, likeness: Likeness, level: Level, described: Level, h: float, wide_h: float
) -> Float[Tensor, "k m s"]:
    rows = level.keypoints
    rows = rows[evenly(len(rows), _HEARD)]
    keypoint = torch.cdist(level.points[rows], described.points[described.keypoints]).argmin(1)
    k, m = len(contact.points), len(rows)
    zero = contact.distance.new_zeros(k, m)
    alike, own = likeness.found[:, keypoint], contact.own
    columns = [
        *_surface_signals(contact, rows, h),
        *_sight_signals(contact, rows, h, zero),
        *_side_signals(contact, rows),
        alike,
        likeness.most[keypoint] - alike,
        (likeness.distance[:, keypoint] / wide_h).clamp_max(4) / 2,
        own.area[rows].expand(k, -1),
    ]
    return torch.stack([column.to(zero).expand(k, m) for column in columns], -1)


def _surface_signals(contact: Contact, rows: Int[Tensor, " m"], h: float) -> list[Tensor]:
    own, other, partner = contact.own, contact.other, contact.partner[:, rows]
    near = (contact.distance < NEAR * h).to(contact.distance)
    smooth = contact.smooth_height / h
    distance, height, here = contact.distance[:, rows], contact.height[:, rows], smooth[:, rows]
    beside = (distance.square() - height.square()).clamp_min(0).sqrt()
    around, _ = own.index.knn(own.points[rows], min(_PATCH, len(own.points)))
    small = min(_SMALL_PATCH, around.shape[1])
    of_near = torch.stack([near, smooth.clamp(-2, 2) * near, contact.cosine * near])
    count, tilt, _ = _sums(of_near, around[:, :small])
    wide_count, wide_tilt, wide_cosine = _sums(of_near, around)
    cosine = contact.cosine[:, rows]
    return [
        (distance / h).clamp_max(4),
        3 * distance.clamp_max(0.6),
        (height / h).clamp(-3, 3),
        (beside / h).clamp_max(3),
        here.clamp(-1.5, 1.5),
        2 * (here * near[:, rows]).abs().clamp_max(0.5),
        2 * tilt / count.clamp_min(1),
        4 * wide_tilt / wide_count.clamp_min(1),
        count / small,
        wide_count / around.shape[1],
        wide_cosine / wide_count.clamp_min(1),
        cosine,
        cosine.abs(),
        near[:, rows],
        own.interior[rows],
        other.interior[partner],
        own.rim[rows],
        other.rim[partner],
        4 * own.roughness[rows],
        4 * other.roughness[partner],
    ]


def _sums(values: Float[Tensor, "c k n"], around: Int[Tensor, "m p"]) -> Float[Tensor, "c k m"]:
    """Sums over the points around; a product is faster than gathering them."""
    member = values.new_zeros(len(around), values.shape[-1]).scatter_(1, around, 1.0)
    return values @ member.T


def _sight_signals(
    contact: Contact, rows: Int[Tensor, " m"], h: float, zero: Tensor
) -> list[Tensor]:
    image = contact.other.image
    if image is None:
        return [zero] * 6
    points = contact.points[:, rows]
    look = image.look(points)
    sight = points - image.viewpoints[0]
    sight = sight / sight.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    grazing = (contact.normals[:, rows] * sight).sum(-1)
    behind = (look.behind[0] / h).clamp(-6, 6) / 2
    masks = (look.in_nothing[0], look.outside[0], look.in_front[0])
    return [behind, *masks, grazing, zero + 1]


def _side_signals(contact: Contact, rows: Int[Tensor, " m"]) -> list[Tensor]:
    facing = contact.other.facing
    offset = contact.points[:, rows] - contact.other.points.mean(0)
    return [
        2 * contact.normals[:, rows] @ facing,
        2 * offset @ (facing / facing.norm().clamp_min(1e-6)),
        offset.norm(dim=-1),
    ]
