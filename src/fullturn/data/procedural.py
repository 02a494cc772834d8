"""Objects made from formulas: endless shapes, with and without symmetry, without data files."""

from __future__ import annotations

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from fullturn.data.families import FAMILIES
from fullturn.data.motion import uniform_rotation
from fullturn.data.solids import (
    curve,
    join,
    lathe,
    placed,
    smooth,
    superquadric,
    to_unit_ball,
    tube,
)


def procedural_family(rng: np.random.Generator) -> str:
    """The family of the object that `procedural_mesh` makes from a generator in the same state."""
    return str(rng.choice(list(FAMILIES)))


def procedural_mesh(rng: np.random.Generator) -> trimesh.Trimesh:
    """A random object of a random family, in the unit ball around its surface centroid.

    ``mesh.metadata["family"]`` names the family. Some families are exactly symmetric, some carry
    one small feature that breaks the symmetry; the orientation is random.
    """
    family = procedural_family(rng)
    mesh = to_unit_ball(placed(FAMILIES[family](rng), rotation=uniform_rotation(rng)))
    mesh.metadata["family"] = family
    return mesh


def demo_object() -> trimesh.Trimesh:
    """A teapot, hard on purpose: most of it is round, only spout and askew handle tell the pose."""
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


def dog() -> trimesh.Trimesh:
    """A walking dog that looks aside: recognizable from every side, and no two sides are alike."""
    body = [
        superquadric((0.62, 0.27, 0.29), (0.9, 0.9)),
        placed(superquadric((0.32, 0.29, 0.34)), translation=(0.36, 0, 0.02)),
        tube(curve([(0.42, 0, 0.05), (0.6, 0, 0.35), (0.66, 0.02, 0.6)]), 0.17),
        tube(
            curve([(-0.55, 0, 0.12), (-0.8, 0.03, 0.25), (-0.95, 0.14, 0.5), (-0.88, 0.22, 0.72)]),
            0.06,
        ),
    ]
    for hip, foot, side in (
        (0.4, 0.62, 0.16),
        (0.42, 0.4, -0.16),
        (-0.42, -0.42, 0.17),
        (-0.44, -0.66, -0.17),
    ):
        knee = (hip + foot) / 2 + 0.05
        body.append(
            tube(curve([(hip, side, -0.05), (knee, side, -0.42), (foot, side, -0.8)]), 0.095)
        )
        body.append(placed(superquadric((0.15, 0.1, 0.07)), translation=(foot + 0.06, side, -0.8)))
    skull, muzzle = superquadric((0.25, 0.21, 0.21)), superquadric((0.24, 0.11, 0.1), (0.7, 0.7))
    nose, ear = superquadric((0.05, 0.06, 0.045)), superquadric((0.08, 0.035, 0.19))
    head = join(
        [
            skull,
            placed(muzzle, translation=(0.27, 0, -0.07)),
            placed(nose, translation=(0.5, 0, -0.01)),
            placed(ear, rotation=_about("x", 20.0), translation=(-0.06, -0.23, -0.06)),
            placed(ear, rotation=_about("x", 160.0), translation=(-0.08, 0.2, 0.2)),
        ]
    )
    mesh = to_unit_ball(
        join([*body, placed(head, rotation=_about("z", 35.0), translation=(0.7, 0.03, 0.68))])
    )
    mesh.metadata["family"] = "dog"
    return mesh


def _about(axis: str, angle_deg: float) -> Float[np.ndarray, "3 3"]:
    return Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()
