"""The last refinement: all scans of a group at once, surface to surface."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.geometry.neighbors import NeighborIndex
from fullturn.pose.kabsch import nearest_motion
from fullturn.pose.residuals import plane_equations

# Rounds begin with about so many points of each scan, as long as steps are longer than _NEAR: a
# ring of scans closes slowly, in twenty rounds and more.
_FIRST_POINTS, _FIRST_ROUNDS, _NEAR = 1_000, 60, 1e-3
_ROUNDS = 30
_LEAST_SHARE = 0.03  # of a scan's points near the other: below, two scans don't overlap
_MOST_PARTNERS = 15  # scans that each one is pulled towards, those that it overlaps most
# Steps are in radians and in units of the fusion.
_LARGEST_STEP = 0.1  # small enough for the equations, which are linear in it
_SETTLED = 1e-5  # far below what noise leaves open
_DAMPING = 1e-6  # of H's mean diagonal: solvable also where a flat scan may slide
_REACH = 6.0  # deviations; more than Tukey's four, as points lie apart along the surface, too
_STEADY = 0.9  # a reach that shrinks by less than a tenth shrinks no more
_DEVIATION = 0.6745  # the median of |x| for a standard normal x
_TUKEY = 4.0  # what is so many deviations off doesn't belong together
_ALIKE = 0.5  # least |cos| between normals, 60°: surfaces that cross aren't the same one


def refine_joint(
    T_group_scan: Float[Tensor, "n 4 4"],
    points: Sequence[Float[Tensor, "_ 3"]],
    normals: Sequence[Float[Tensor, "_ 3"]],
    *,
    reach: float,
    closest: float,
) -> Float[Tensor, "n 4 4"]:
    """The poses at which all overlapping surfaces lie on one another best; the first one is held.

    Every scan's points are pulled towards the tangent planes of the scans that they are near, and
    all motions are solved for together, so that errors don't add up around the object. Points
    within `reach` count as near at first; it shrinks with the residuals down to `closest`.
    """
    T = T_group_scan.clone()
    trees = [NeighborIndex(cloud) for cloud in points]
    few = [max(1, len(cloud) // _FIRST_POINTS) for cloud in points]
    for every, rounds, enough in (
        (few, _FIRST_ROUNDS, _NEAR),
        ([1] * len(points), _ROUNDS, _SETTLED),
    ):
        pairs = _partners(T, points, trees, reach, few)
        for _ in range(rounds):
            H, g, sigma = _equations(T, points, normals, trees, pairs, reach, every)
            if not torch.isfinite(sigma):
                break
            step = _step(H, g)
            T = nearest_motion(rigid.exp_se3(step) @ T)
            shrunk = max(closest, min(reach, _REACH * float(sigma)))
            is_settled = float(step.abs().max()) < enough and shrunk > _STEADY * reach
            reach = shrunk
            if is_settled:
                break
    return T


def _step(H: Float[Tensor, "m m"], g: Float[Tensor, " m"]) -> Float[Tensor, "n 6"]:
    """Motions of all scans; none of the first one, which is the frame."""
    damping = _DAMPING * H.diagonal().mean() + 1e-300
    damped = H + torch.eye(len(H), dtype=H.dtype, device=H.device) * damping
    step = torch.zeros_like(g)
    step[6:] = -torch.linalg.solve(damped[6:, 6:], g[6:])
    return step.view(-1, 6).clamp(-_LARGEST_STEP, _LARGEST_STEP)


def _partners(
    T: Float[Tensor, "n 4 4"],
    points: Sequence[Tensor],
    trees: Sequence[NeighborIndex],
    reach: float,
    every: Sequence[int],
) -> list[tuple[int, int]]:
    """Each scan with those that it overlaps most; with all others, where they are few."""
    numbers = range(len(points))
    others = [[j for j in numbers if j != i] for i in numbers]
    if len(points) > 1 + _MOST_PARTNERS:
        for i in numbers:
            own = rigid.apply(T[i], points[i][:: every[i]])
            share = torch.zeros(len(points))
            for j in others[i]:
                partner, _ = trees[j].nearest(rigid.apply(rigid.invert(T[j]), own), within=reach)
                share[j] = (partner >= 0).double().mean()
            others[i] = share.topk(_MOST_PARTNERS).indices.sort().values.tolist()
    return [(i, j) for i in numbers for j in others[i]]


def _equations(
    T: Float[Tensor, "n 4 4"],
    points: Sequence[Tensor],
    normals: Sequence[Tensor],
    trees: Sequence[NeighborIndex],
    pairs: Sequence[tuple[int, int]],
    reach: float,
    every: Sequence[int],
) -> tuple[Float[Tensor, "m m"], Float[Tensor, " m"], Float[Tensor, ""]]:
    """Gauss–Newton's H and g of small motions of all scans in the common frame, and the noise.

    Of each scan's points, one in `every` is pulled. A pair's residual depends on the difference of
    two motions, so its 6×6 block enters four times.
    """
    count = len(points)
    found = []
    for i, j in pairs:
        near = _near(T, points, normals, trees, i, j, reach, every[i])
        if near is not None:
            found.append((i, j, *near))
    H, g = T.new_zeros(count, 6, count, 6), T.new_zeros(count, 6)
    if not found:
        return H.view(6 * count, -1), g.view(-1), T.new_tensor(torch.inf)
    heights = torch.cat([(difference * normal).sum(-1) for *_, difference, normal in found])
    sigma = heights.abs().median() / _DEVIATION + 1e-9
    for i, j, at, difference, normal in found:
        height = (difference * normal).sum(-1)
        weight = (1.0 - (height / (_TUKEY * sigma)).square()).clamp_min(0).square()
        block, pull = plane_equations(at.T, difference.T, normal.T, weight)
        H[i, :, i] += block
        H[j, :, j] += block
        H[i, :, j] -= block
        H[j, :, i] -= block
        g[i] += pull
        g[j] -= pull
    return H.view(6 * count, -1), g.view(-1), sigma


def _near(
    T: Tensor,
    points: Sequence[Tensor],
    normals: Sequence[Tensor],
    trees: Sequence[NeighborIndex],
    i: int,
    j: int,
    reach: float,
    every: int,
) -> tuple[Tensor, Tensor, Tensor] | None:
    """Scan i's points near scan j: where, how far from their partner, and the partner's normal."""
    T_j_i = rigid.invert(T[j]) @ T[i]
    own_points, own_normals = points[i][::every], normals[i][::every]
    moved = rigid.apply(T_j_i, own_points)
    partner, _ = trees[j].nearest(moved, within=reach)
    near = partner >= 0
    if float(near.double().mean()) < _LEAST_SHARE:
        return None
    own = own_normals[near] @ T_j_i[:3, :3].mT
    other = normals[j][partner[near]]
    alike = (own * other).sum(-1).abs() > _ALIKE
    difference = (moved[near] - points[j][partner[near]])[alike] @ T[j, :3, :3].mT
    at = rigid.apply(T[i], own_points[near][alike])
    return at, difference, other[alike] @ T[j, :3, :3].mT
