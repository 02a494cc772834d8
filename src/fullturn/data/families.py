"""Families of generated objects; each function makes one random member."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh

from fullturn.data.motion import uniform_direction, uniform_rotation
from fullturn.data.solids import (
    bent_sheet,
    box,
    curve,
    frustum,
    join,
    lathe,
    placed,
    prism,
    smooth,
    superquadric,
    to_unit_ball,
    torus,
    tube,
)
from fullturn.data.surface import sample_surface


def _primitive(rng: np.random.Generator) -> trimesh.Trimesh:
    size = rng.uniform(0.2, 1.0, 3)
    kind = rng.integers(6)
    if kind == 0:
        return box(size)
    if kind == 1:
        return frustum(size[0] / 2, size[0] / 2, size[1])
    if kind == 2:
        return frustum(size[0] / 2, size[0] / 2 * rng.uniform(0.0, 0.7), size[1])
    if kind == 3:
        return superquadric(size / 2)
    if kind == 4:
        return torus(size[0] / 2, size[0] * rng.uniform(0.08, 0.2))
    return superquadric(size / 2, (rng.uniform(0.2, 1.8), rng.uniform(0.2, 1.8)))


def _union(rng: np.random.Generator) -> trimesh.Trimesh:
    """Two to six primitives, each grown from a point on what is there already."""
    mesh = _primitive(rng)
    aligned = rng.random() < 0.5
    for _ in range(rng.integers(1, 6)):
        part = _primitive(rng)
        mesh = join(
            [
                mesh,
                placed(
                    part,
                    rotation=None if aligned else uniform_rotation(rng),
                    translation=sample_surface(mesh, 1, rng)[0],
                ),
            ]
        )
    return mesh


def _turned(rng: np.random.Generator) -> trimesh.Trimesh:
    """A surface of revolution: any turn about its axis maps it onto itself."""
    knots = int(rng.integers(3, 8))
    height = np.linspace(0.0, rng.uniform(0.5, 2.5), knots)
    profile = [(0.0, height[0])]
    profile += [(rng.uniform(0.15, 0.8), h) for h in height]
    profile += [(0.0, height[-1])]
    points = np.array(profile) if rng.random() < 0.4 else smooth(profile)
    return lathe(points)


def _n_fold(rng: np.random.Generator) -> trimesh.Trimesh:
    """A body of revolution with two to eight equal parts around it."""
    order = int(rng.integers(2, 9))
    part = placed(_primitive(rng), rotation=uniform_rotation(rng))
    reach = np.array([rng.uniform(0.3, 0.9), 0.0, rng.uniform(-0.3, 0.3)])
    parts = [_turned(rng)]
    for turn in range(order):
        angle = 2.0 * np.pi * turn / order
        rotation = np.array(
            [[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0, 0, 1.0]]
        )
        parts.append(placed(part, rotation=rotation, translation=rotation @ reach))
    return join(parts)


def _nearly_symmetric(rng: np.random.Generator) -> trimesh.Trimesh:
    """A symmetric body with one small feature that alone tells its poses apart."""
    symmetric = (_turned, _n_fold, _block, _quadric)
    body = to_unit_ball(symmetric[rng.integers(len(symmetric))](rng))
    feature = to_unit_ball(placed(_primitive(rng), rotation=uniform_rotation(rng)))
    feature.vertices *= rng.uniform(0.1, 0.25)
    return join([body, placed(feature, translation=sample_surface(body, 1, rng)[0])])


def _block(rng: np.random.Generator) -> trimesh.Trimesh:
    return box(rng.uniform(0.2, 1.0, 3))


def _letter(rng: np.random.Generator) -> trimesh.Trimesh:
    """An L, T, U, Z, H or stepped shape made of boxes."""
    t, w, h, d = (
        rng.uniform(0.12, 0.35),
        rng.uniform(0.5, 1),
        rng.uniform(0.6, 1.2),
        rng.uniform(0.1, 0.8),
    )
    upright = box((t, d, h), (0, 0, h / 2))
    kind = rng.integers(6)
    if kind == 0:
        return join([upright, box((w, d, t), (w / 2, 0, t / 2))])
    if kind == 1:
        return join([upright, box((w, d, t), (rng.uniform(-0.1, 0.1), 0, h))])
    if kind == 2:
        other = box((t, d, h * rng.uniform(0.4, 1)), (w, 0, h / 2))
        return join([upright, other, box((w, d, t), (w / 2, 0, t / 2))])
    if kind == 3:
        return join(
            [
                upright,
                box((w, d, t), (w / 2, 0, t / 2)),
                box((w * 0.8, d, t), (-w * 0.4, 0, h - t / 2)),
            ]
        )
    if kind == 4:
        bar = box((w, d, t), (w / 2, 0, h * rng.uniform(0.3, 0.7)))
        return join([upright, box((t, d, h), (w, 0, h / 2)), bar])
    steps = int(rng.integers(3, 7))
    return join(
        [
            box((w / steps, d, h * (i + 1) / steps), (w * i / steps, 0, h * (i + 1) / steps / 2))
            for i in range(steps)
        ]
    )


def _table(rng: np.random.Generator) -> trimesh.Trimesh:
    w, d, h = rng.uniform(0.5, 1.5), rng.uniform(0.5, 1), rng.uniform(0.4, 1)
    leg, top = rng.uniform(0.04, 0.1), rng.uniform(0.03, 0.1)
    x, y = w / 2 - leg / 2, d / 2 - leg / 2
    parts = [box((w, d, top), (0, 0, h))]
    parts += [box((leg, leg, h), (sx * x, sy * y, h / 2)) for sx in (-1, 1) for sy in (-1, 1)]
    if rng.random() < 0.5:
        parts.append(box((w * 0.35, d * 0.9, h * 0.5), (w * 0.3, 0, h * 0.7)))
    return join(parts)


def _chair(rng: np.random.Generator) -> trimesh.Trimesh:
    w, d, h, back = (
        rng.uniform(0.4, 0.7),
        rng.uniform(0.4, 0.7),
        rng.uniform(0.3, 0.6),
        rng.uniform(0.4, 0.8),
    )
    leg = rng.uniform(0.03, 0.08)
    x, y = w / 2 - leg / 2, d / 2 - leg / 2
    parts = [box((w, d, 0.06), (0, 0, h)), box((w, 0.06, back), (0, y, h + back / 2))]
    parts += [box((leg, leg, h), (sx * x, sy * y, h / 2)) for sx in (-1, 1) for sy in (-1, 1)]
    arms = {0: (), 1: (1,), 2: (-1, 1)}[int(rng.integers(3))]
    parts += [box((leg, d, leg), (s * x, 0, h + 0.25)) for s in arms]
    parts += [box((leg, leg, 0.25), (s * x, -y, h + 0.125)) for s in arms]
    return join(parts)


def _shelf(rng: np.random.Generator) -> trimesh.Trimesh:
    w, d, h, t = rng.uniform(0.5, 1.2), rng.uniform(0.2, 0.5), rng.uniform(0.8, 1.8), 0.05
    parts = [box((t, d, h), (s * w / 2, 0, h / 2)) for s in (-1, 1)]
    parts += [box((w, d, t), (0, 0, z)) for z in np.linspace(0, h, int(rng.integers(3, 6)))]
    if rng.random() < 0.6:
        parts.append(box((w, 0.03, h), (0, d / 2, h / 2)))
    for _ in range(rng.integers(0, 4)):
        size = rng.uniform(0.05, 0.2, 3)
        parts.append(box(size, (rng.uniform(-0.4, 0.4) * w, 0, rng.uniform(0.1, 0.9) * h)))
    return join(parts)


def _airplane(rng: np.random.Generator) -> trimesh.Trimesh:
    """Fuselage, swept wings, tail, sometimes engines; mirror symmetric, as airplanes are."""
    width = rng.uniform(0.05, 0.09)
    parts = [superquadric((0.5, width, width * rng.uniform(0.8, 1.2)))]
    span, taper = rng.uniform(0.3, 0.6), rng.uniform(0.3, 0.9)
    tip = (-rng.uniform(0.0, 0.7) * span, span, rng.uniform(-0.1, 0.15) * span)
    root = (rng.uniform(-0.1, 0.1), 0.0, rng.uniform(-0.04, 0.06))
    parts += _wings(root, tip, chord=rng.uniform(0.12, 0.25), taper=taper)
    tail = rng.uniform(0.12, 0.22)
    parts += _wings(
        (-0.43, 0.0, rng.uniform(0.0, 0.2)), (-0.4 * tail, tail, 0.0), chord=0.08, taper=taper
    )
    parts.append(box((rng.uniform(0.06, 0.12), 0.02, 0.2), (-0.44, 0, 0.1)))
    for _ in range(rng.integers(0, 3)):
        x, y, r = rng.uniform(-0.1, 0.15), rng.uniform(0.12, 0.28), rng.uniform(0.02, 0.04)
        engine = superquadric((0.08, r, r), sections=24)
        parts += [placed(engine, translation=(x, side * y, -0.04)) for side in (-1, 1)]
    return join(parts)


def _wings(
    root: tuple[float, float, float],
    reach: tuple[float, float, float],
    *,
    chord: float,
    taper: float,
) -> list[trimesh.Trimesh]:
    """A left and a right wing from the root, of full chord there and tapered at the tip."""
    section = chord / 2.0 * np.array([[-1.0, 0, 0], [-1.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0]])
    section[:, 2] = (-0.01, 0.01, -0.01, 0.01)
    outline = np.concatenate([section, section * (taper, 1.0, 1.0) + reach]) + root
    return [trimesh.convex.convex_hull(outline * (1.0, side, 1.0)) for side in (1.0, -1.0)]


def _extruded(rng: np.random.Generator) -> trimesh.Trimesh:
    """A random or gear-shaped polygon, extruded, sometimes twisted and tapered."""
    if rng.random() < 0.4:
        teeth = int(rng.integers(3, 13))
        angle = np.arange(teeth * 4) * (2.0 * np.pi / (teeth * 4))
        radius = np.tile([1.0, 1.0, 1.0 - (depth := rng.uniform(0.1, 0.4)), 1.0 - depth], teeth)
    else:
        corners = int(rng.integers(3, 10))
        angle = (
            np.sort(rng.uniform(-0.3, 0.3, corners) + np.arange(corners)) * 2.0 * np.pi / corners
        )
        radius = rng.uniform(0.4, 1.0, corners)
    polygon = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    return prism(
        polygon,
        rng.uniform(0.2, 2.0),
        twist_rad=rng.uniform(-1.5, 1.5) if rng.random() < 0.4 else 0.0,
        taper=rng.uniform(0.3, 1.0) if rng.random() < 0.4 else 1.0,
    )


def _sheet(rng: np.random.Generator) -> trimesh.Trimesh:
    sheet = bent_sheet(
        1.0,
        rng.uniform(0.3, 1.2),
        rng.uniform(0.02, 0.08),
        bend_rad=rng.uniform(-4.5, 4.5),
        wave=rng.uniform(-0.1, 0.1),
    )
    if rng.random() < 0.5:
        return sheet
    return join([sheet, placed(_block(rng), translation=sample_surface(sheet, 1, rng)[0])])


def _quadric(rng: np.random.Generator) -> trimesh.Trimesh:
    return superquadric(rng.uniform(0.25, 1.0, 3), (rng.uniform(0.15, 2), rng.uniform(0.15, 2)))


def _bent_quadric(rng: np.random.Generator) -> trimesh.Trimesh:
    """A superquadric that is tapered, twisted and bent."""
    mesh = _quadric(rng)
    x, y, z = mesh.vertices.T
    scale = 1.0 + rng.uniform(-0.6, 0.6) * z / np.abs(z).max()
    angle = rng.uniform(-2.0, 2.0) * z
    x, y = scale * x, scale * y
    x, y = np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y
    bent = np.stack([x + rng.uniform(-0.8, 0.8) * z**2, y, z], axis=1)
    return trimesh.Trimesh(bent, mesh.faces, process=False)


def _pipes(rng: np.random.Generator) -> trimesh.Trimesh:
    """One to three bent pipes from one place, sometimes on a base."""
    parts = []
    for _ in range(rng.integers(1, 4)):
        knots = np.cumsum([np.zeros(3)] + [uniform_direction(rng) * 0.5 for _ in range(4)], axis=0)
        parts.append(tube(curve(knots), rng.uniform(0.04, 0.12)))
    if rng.random() < 0.4:
        parts.append(_block(rng))
    return join(parts)


def _vessel(rng: np.random.Generator) -> trimesh.Trimesh:
    """A turned body with a handle, sometimes with a spout: a mug, a jug, a pot."""
    body = to_unit_ball(_turned(rng))
    top, bottom = body.vertices[:, 2].max(), body.vertices[:, 2].min()
    reach = np.hypot(body.vertices[:, 0], body.vertices[:, 1]).max()
    size = rng.uniform(0.15, 0.35) * (top - bottom)
    angle = np.linspace(-2.0, 2.0, 20)
    handle = np.stack(
        [
            reach * rng.uniform(0.8, 1.0) + size * np.cos(angle),
            np.zeros_like(angle),
            rng.uniform(0.8, 1.2) * size * np.sin(angle) + rng.uniform(-0.2, 0.2) * (top - bottom),
        ],
        axis=1,
    )
    parts = [body, tube(handle, rng.uniform(0.03, 0.08))]
    if rng.random() < 0.5:
        ends = [(-0.6 * reach, 0, bottom * 0.3), (-reach - 0.2, 0, 0), (-reach - 0.4, 0, top * 0.9)]
        parts.append(tube(curve(ends), rng.uniform(0.05, 0.1)))
    return join(parts)


FAMILIES: dict[str, Callable[[np.random.Generator], trimesh.Trimesh]] = {
    "union": _union,
    "turned": _turned,
    "n_fold": _n_fold,
    "nearly_symmetric": _nearly_symmetric,
    "box": _block,
    "letter": _letter,
    "table": _table,
    "chair": _chair,
    "shelf": _shelf,
    "airplane": _airplane,
    "extruded": _extruded,
    "sheet": _sheet,
    "superquadric": _quadric,
    "bent_superquadric": _bent_quadric,
    "pipes": _pipes,
    "vessel": _vessel,
}
