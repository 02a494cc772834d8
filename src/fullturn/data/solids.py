"""Closed surfaces from formulas: the parts that `procedural` builds its objects of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, PchipInterpolator


def grid_surface(
    grid: Float[np.ndarray, "rows columns 3"], *, wrap_rows: bool, wrap_columns: bool
) -> trimesh.Trimesh:
    """The triangle mesh of a grid of points, two triangles a cell, degenerate ones left out."""
    rows, columns = grid.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    if wrap_rows:
        index = np.concatenate([index, index[:1]], axis=0)
    if wrap_columns:
        index = np.concatenate([index, index[:, :1]], axis=1)
    a, b, c, d = (
        part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    )
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    vertices = grid.reshape(-1, 3)
    corner = vertices[faces]
    area = np.linalg.norm(
        np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1
    )
    return trimesh.Trimesh(vertices, faces[area > 1e-12], process=False)


def box(
    extents: Sequence[float] | np.ndarray, center: Sequence[float] = (0.0, 0.0, 0.0)
) -> trimesh.Trimesh:
    """A box along the axes."""
    mesh = trimesh.creation.box(extents=np.asarray(extents, dtype=np.float64))
    mesh.apply_translation(np.asarray(center, dtype=np.float64))
    return mesh


def lathe(profile: Float[np.ndarray, "k 2"], *, sections: int = 64) -> trimesh.Trimesh:
    """The surface that a profile of (radius, height) sweeps around the z axis."""
    angle = np.arange(sections) * (2.0 * np.pi / sections)
    radius, height = profile[:, :1], profile[:, 1:]
    grid = np.stack(
        [
            radius * np.cos(angle),
            radius * np.sin(angle),
            np.broadcast_to(height, (len(profile), sections)),
        ],
        axis=2,
    )
    return grid_surface(grid, wrap_rows=False, wrap_columns=True)


def frustum(bottom: float, top: float, height: float, *, sections: int = 64) -> trimesh.Trimesh:
    """A closed cylinder or cone along z, centered; the radii may be 0."""
    half = height / 2.0
    profile = np.array([[0.0, -half], [bottom, -half], [top, half], [0.0, half]])
    return lathe(profile, sections=sections)


def superquadric(
    radii: Sequence[float] | np.ndarray,
    exponents: tuple[float, float] = (1.0, 1.0),
    *,
    sections: int = 48,
) -> trimesh.Trimesh:
    """A superellipsoid: exponents 1, 1 give an ellipsoid, near 0 a box, 2 an octahedron."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, sections // 2 + 1)[:, None]
    longitude = (np.arange(sections) * (2.0 * np.pi / sections))[None, :]

    def power(value: np.ndarray, exponent: float) -> np.ndarray:
        return np.sign(value) * np.abs(value) ** exponent

    ring = power(np.cos(latitude), exponents[0])
    grid = np.stack(
        np.broadcast_arrays(
            radii[0] * ring * power(np.cos(longitude), exponents[1]),
            radii[1] * ring * power(np.sin(longitude), exponents[1]),
            radii[2] * power(np.sin(latitude), exponents[0]),
        ),
        axis=2,
    )
    return grid_surface(grid, wrap_rows=False, wrap_columns=True)


def tube(
    path: Float[np.ndarray, "k 3"], radius: float, *, closed: bool = False, sections: int = 16
) -> trimesh.Trimesh:
    """A round tube of one radius along a path, with flat ends or closed to a ring."""
    if closed:
        tangent = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0)
    else:
        tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    # Carried along rather than computed per point, so that the rings do not twist.
    side = np.empty_like(path)
    side[0] = np.cross(tangent[0], np.eye(3)[np.argmin(np.abs(tangent[0]))])
    side[0] /= np.linalg.norm(side[0])
    for i in range(1, len(path)):
        side[i] = side[i - 1] - (side[i - 1] @ tangent[i]) * tangent[i]
        side[i] /= np.linalg.norm(side[i])
    other = np.cross(tangent, side)
    angle = np.arange(sections) * (2.0 * np.pi / sections)
    ring = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * other[:, None]
    grid = path[:, None] + radius * ring
    if not closed:
        ends = [np.repeat(path[i][None, None], sections, axis=1) for i in (0, -1)]
        grid = np.concatenate([ends[0], grid, ends[1]])
    return grid_surface(grid, wrap_rows=closed, wrap_columns=True)


def torus(major: float, minor: float, *, sections: int = 48) -> trimesh.Trimesh:
    """A torus about the z axis."""
    angle = np.arange(sections) * (2.0 * np.pi / sections)
    path = np.stack([major * np.cos(angle), major * np.sin(angle), np.zeros(sections)], axis=1)
    return tube(path, minor, closed=True)


def prism(
    polygon: Float[np.ndarray, "k 2"],
    height: float,
    *,
    twist_rad: float = 0.0,
    taper: float = 1.0,
    steps: int = 12,
) -> trimesh.Trimesh:
    """A polygon extruded along z, turned and scaled on the way, with caps.

    The caps are fans about the origin, so the polygon must see it (star-shaped).
    """
    share = np.linspace(0.0, 1.0, steps)
    angle, scale = twist_rad * share, 1.0 + (taper - 1.0) * share
    cos, sin = (scale * np.cos(angle))[:, None], (scale * np.sin(angle))[:, None]
    x, y = polygon[:, 0], polygon[:, 1]
    z = np.broadcast_to(((share - 0.5) * height)[:, None], (steps, len(polygon)))
    wall = np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=2)
    caps = [np.zeros((1, len(polygon), 3)) for _ in range(2)]
    caps[0][..., 2], caps[1][..., 2] = -height / 2.0, height / 2.0
    return grid_surface(
        np.concatenate([caps[0], wall, caps[1]]), wrap_rows=False, wrap_columns=True
    )


def bent_sheet(
    length: float, width: float, thickness: float, *, bend_rad: float, wave: float = 0.0
) -> trimesh.Trimesh:
    """A thick sheet bent around the y axis, with an optional wave across its width."""
    along, across = np.linspace(-0.5, 0.5, 40), np.linspace(-0.5, 0.5, 24)
    angle = bend_rad * along
    curvature = bend_rad / length if abs(bend_rad) > 1e-6 else 0.0
    if curvature:
        x, z = np.sin(angle) / curvature, (1.0 - np.cos(angle)) / curvature
    else:
        x, z = length * along, np.zeros_like(along)
    normal = np.stack([-np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
    center = (
        np.stack(np.broadcast_arrays(x[:, None], width * across[None, :], z[:, None]), axis=2)
        + (wave * np.sin(2.0 * np.pi * across))[None, :, None] * normal[:, None]
    )
    offset = 0.5 * thickness * normal[:, None]
    # Top, then bottom walked back, so that wrapping the columns closes both long edges.
    around = np.concatenate([center + offset, (center - offset)[:, ::-1]], axis=1)
    middle = [np.broadcast_to(center[i].mean(axis=0), around[i].shape)[None] for i in (0, -1)]
    return grid_surface(
        np.concatenate([middle[0], around, middle[1]]), wrap_rows=False, wrap_columns=True
    )


def join(parts: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """All parts in one mesh; surfaces inside other parts are kept."""
    starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    return trimesh.Trimesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]),
        process=False,
    )


def placed(
    mesh: trimesh.Trimesh,
    *,
    rotation: Float[np.ndarray, "3 3"] | None = None,
    translation: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
) -> trimesh.Trimesh:
    """A moved copy."""
    vertices = mesh.vertices if rotation is None else mesh.vertices @ rotation.T
    return trimesh.Trimesh(vertices + np.asarray(translation), mesh.faces, process=False)


def to_unit_ball(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A copy centered on its area-weighted centroid, the farthest vertex at distance 1."""
    corner = mesh.vertices[mesh.faces]
    area = np.linalg.norm(
        np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1
    )
    centered = mesh.vertices - (corner.mean(axis=1) * area[:, None]).sum(axis=0) / area.sum()
    radius = np.linalg.norm(centered[np.unique(mesh.faces)], axis=1).max()
    return trimesh.Trimesh(centered / radius, mesh.faces, process=False)


def curve(knots: ArrayLike, *, count: int = 32) -> Float[np.ndarray, "count 3"]:
    """A smooth path through the knots."""
    points = np.asarray(knots, dtype=np.float64)
    return CubicSpline(np.arange(len(points)), points)(np.linspace(0, len(points) - 1, count))


def smooth(profile: ArrayLike, *, count: int = 40) -> Float[np.ndarray, "count 2"]:
    """A profile through the knots without overshoot, so that no radius turns negative."""
    points = np.asarray(profile, dtype=np.float64)
    return PchipInterpolator(np.arange(len(points)), points)(np.linspace(0, len(points) - 1, count))
