"""Planes of a scene that are too large to be of the model: tables, floors, walls."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.data.camera import sphere_directions
from fullturn.geometry.normals import estimate_normals

_MOST = 4  # planes of a scene
_CANDIDATES = 250
_COUNTED = 3000  # points that candidates are compared on
_BEYOND = 1.15  # of the model's diameter: what reaches farther is no part of it
_LEAST_SHARE = 0.08  # of the scene's points


@dataclass(frozen=True, eq=False)
class Plane:
    """The points x with normal · x = offset, and which points of the scene lie on it."""

    normal: Float[Tensor, "3"]  # to the side where the sensor stood, or else most points lie
    offset: float
    thickness: float  # points that are closer to it belong to it
    members: Bool[Tensor, " n"]

    def height(self, points: Float[Tensor, "*batch n 3"]) -> Float[Tensor, "*batch n"]:
        """How far above the plane points lie; below it is negative."""
        return points @ self.normal.to(points.dtype) - self.offset


def large_planes(
    points: Float[Tensor, "n 3"],
    *,
    diameter: float,
    spacing: float,
    viewpoint: Float[Tensor, "3"] | None,
) -> list[Plane]:
    """Planes whose points reach farther than any two points of the model, the largest first.

    Candidates are the tangent planes of points that are spread over the rows; no random draws.
    Points are best evenly spread (voxel means), so that counting them measures area.
    """
    found: list[Plane] = []
    rest = torch.ones(len(points), dtype=torch.bool, device=points.device)
    while len(found) < _MOST and int(rest.sum()) > max(30, _LEAST_SHARE * len(points)):
        plane = _largest(points, rest, spacing)
        members = plane.members
        if int(members.sum()) < max(30, _LEAST_SHARE * len(points)):
            break
        if extent(points[members]) < _BEYOND * diameter:
            break
        found.append(_facing(plane, points, viewpoint))
        rest &= ~members
    return found


def extent(points: Float[Tensor, "n 3"]) -> float:
    """About the largest distance of two points: the widest of the cloud's shadows on 40 lines."""
    lines = torch.from_numpy(sphere_directions(80)[:40]).to(points)
    shadow = points @ lines.T
    return float((shadow.amax(0) - shadow.amin(0)).amax())


def _largest(points: Tensor, rest: Tensor, spacing: float) -> Plane:
    """The plane with the most points among the rest, fit to them."""
    among = points[rest]
    some = among[:: -(-len(among) // _COUNTED)]
    at = some[:: -(-len(some) // _CANDIDATES)]
    # Wide neighborhoods: noise tilts small ones.
    normals = estimate_normals(some, k=min(40, len(some)), queries=at, orientation="none").normals
    heights = some @ normals.T - (at * normals).sum(1)
    best = int((heights.abs() < spacing).sum(0).argmax())
    normal, offset = normals[best], float(at[best] @ normals[best])
    thickness = spacing
    for band in (2.0 * spacing, 1.5 * spacing, spacing):
        near = among[(among @ normal - offset).abs() < band]
        mean = near.mean(0)
        centered = near - mean
        normal = torch.linalg.eigh(centered.T @ centered)[1][:, 0]
        offset = float(mean @ normal)
        sigma = 1.4826 * float((centered @ normal).abs().median())
        thickness = min(max(3.0 * sigma, 0.35 * spacing), 1.5 * spacing)
    members = rest & ((points @ normal - offset).abs() < thickness)
    return Plane(normal, offset, thickness, members)


def _facing(plane: Plane, points: Tensor, viewpoint: Tensor | None) -> Plane:
    if viewpoint is None:
        others = plane.height(points[~plane.members])
        above = float((others > 0).sum() - (others < 0).sum())
    else:
        above = float(plane.height(viewpoint.to(points)[None])[0])
    sign = math.copysign(1.0, above)
    return Plane(sign * plane.normal, sign * plane.offset, plane.thickness, plane.members)
