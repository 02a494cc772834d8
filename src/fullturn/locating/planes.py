"""Planes of a scene that are too large to be of the model: tables, floors, walls."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from torch import Tensor

from fullturn.geometry.directions import sphere_directions
from fullturn.geometry.normals import estimate_normals

_MOST, _LOOKS = 4, 8  # planes of a scene, and how many are looked at
_ALIGNED = 0.8  # cosine of the normals of a plane and of points on it
LINK = 2.5  # spacings between points of one piece
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
    """Planes with a piece that reaches farther than any two points of the model, largest first.

    Candidates are the tangent planes of points that are spread over the rows; no random draws.
    Points are best evenly spread (voxel means), so that counting them measures area.
    """
    found: list[Plane] = []
    rest = torch.ones(len(points), dtype=torch.bool, device=points.device)
    fewest = max(30, _LEAST_SHARE * len(points))
    for _ in range(_LOOKS):
        if len(found) == _MOST or int(rest.sum()) <= fewest:
            break
        plane = _largest(points, rest, spacing)
        if int(plane.members.sum()) < fewest:
            break
        # Faces of several objects may lie in one plane, far from one another.
        on_plane = points[plane.members]
        piece = pieces(on_plane.numpy(force=True), LINK * spacing)
        largest = on_plane[torch.from_numpy(piece == np.bincount(piece).argmax())]
        if extent(largest) >= _BEYOND * diameter:
            found.append(_facing(plane, points, viewpoint))
        rest &= ~plane.members
    return found


def pieces(points: np.ndarray, link: float) -> np.ndarray:
    """The number of the piece (n,) that each point belongs to; gaps above `link` part pieces."""
    pairs = cKDTree(points).query_pairs(link, output_type="ndarray")
    ones = np.ones(len(pairs), dtype=np.int8)
    graph = coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    return np.asarray(connected_components(graph, directed=False)[1])


def extent(points: Float[Tensor, "n 3"]) -> float:
    """About the largest distance of two points: the widest of the cloud's shadows on 40 lines."""
    lines = torch.from_numpy(sphere_directions(80)[:40]).to(points)
    shadow = points @ lines.T
    return float((shadow.amax(0) - shadow.amin(0)).amax())


def _largest(points: Tensor, rest: Tensor, spacing: float) -> Plane:
    """The plane with the most points among the rest, fit to them."""
    among = points[rest]
    some = among[:: -(-len(among) // _COUNTED)]
    # Wide neighborhoods: noise tilts small ones.
    normals = estimate_normals(some, k=min(40, len(some)), orientation="none")
    every = slice(None, None, -(-len(some) // _CANDIDATES))
    heights = some @ normals[every].T - (some[every] * normals[every]).sum(1)
    # Across an object, a plane meets surfaces of any direction.
    lies = (heights.abs() < spacing) & ((normals @ normals[every].T).abs() > _ALIGNED)
    best = int(lies.sum(0).argmax())
    normal, offset = normals[every][best], float(some[every][best] @ normals[every][best])
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
