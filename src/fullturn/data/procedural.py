"""Objects made from formulas: endless shapes, with and without symmetry, without data files."""

from __future__ import annotations

import numpy as np
import trimesh

from fullturn.data.families import FAMILIES
from fullturn.data.motion import uniform_rotation
from fullturn.data.solids import curve, join, lathe, placed, smooth, to_unit_ball, tube
from fullturn.data.surface import sample_surface

__all__ = ["demo_object", "procedural_mesh", "sample_surface"]


def procedural_mesh(rng: np.random.Generator) -> trimesh.Trimesh:
    """A random object of a random family, in the unit ball around its surface centroid.

    ``mesh.metadata["family"]`` names the family. Some families are exactly symmetric, some carry
    one small feature that breaks the symmetry; the orientation is random.
    """
    family = str(rng.choice(list(FAMILIES)))
    mesh = to_unit_ball(placed(FAMILIES[family](rng), rotation=uniform_rotation(rng)))
    mesh.metadata["family"] = family
    return mesh


def demo_object() -> trimesh.Trimesh:
    """A teapot: recognizable, and without any symmetry since its handle sits askew."""
    body = lathe(
        smooth([(0, 0), (0.5, 0), (0.8, 0.25), (0.85, 0.5), (0.65, 0.85), (0.35, 1), (0, 1)])
    )
    lid = lathe(smooth([(0, 0.98), (0.38, 1.0), (0.3, 1.08), (0.1, 1.12), (0.12, 1.25), (0, 1.3)]))
    spout_path = curve([(0.7, 0, 0.35), (1.05, 0, 0.45), (1.15, 0, 0.75), (1.4, 0, 1.0)])
    angle = np.linspace(-1.9, 1.9, 24)
    handle_path = np.stack(
        [-0.72 - 0.42 * np.cos(angle), 0.1 + 0.08 * angle, 0.52 + 0.34 * np.sin(angle)], axis=1
    )
    parts = [body, lid, tube(spout_path, 0.12), tube(handle_path, 0.07)]
    mesh = to_unit_ball(join(parts))
    mesh.metadata["family"] = "teapot"
    return mesh
