"""Points on triangle meshes."""

from __future__ import annotations

import numpy as np
import trimesh
from jaxtyping import Float, Int


def sample_surface(
    mesh: trimesh.Trimesh, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "count 3"]:
    """`count` points, uniform over the area of a triangle mesh, in random order."""
    return sample_faces(mesh, count, rng)[0][rng.permutation(count)]


def sample_faces(
    mesh: trimesh.Trimesh, count: int, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "count 3"], Int[np.ndarray, " count"]]:
    """`count` points, uniform over the area of a triangle mesh, and the face of each, ascending."""
    corner = np.asarray(mesh.vertices, dtype=np.float64)[np.asarray(mesh.faces)]
    edge_b, edge_c = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = np.linalg.norm(np.cross(edge_b, edge_c), axis=1)
    face = np.repeat(np.arange(len(area)), rng.multinomial(count, area / area.sum()))
    drawn = rng.random((2, count))
    # √u makes the barycentric coordinates uniform over the triangle.
    root = np.sqrt(drawn[0])
    b, c = root * (1.0 - drawn[1]), root * drawn[1]
    points = corner[face, 0] + b[:, None] * edge_b[face] + c[:, None] * edge_c[face]
    return points, face
