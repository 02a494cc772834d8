"""small_gicp's ICPs on clouds that are already centered and scaled."""

from __future__ import annotations

from typing import Literal

import numpy as np
import small_gicp
import torch
from jaxtyping import Float

from fullturn.geometry.sampling import voxel_sample
from fullturn.methods.external.rotation import rigid_or


def thinned(
    points: Float[np.ndarray, "n 3"], *, most_points: int, voxel: float
) -> Float[np.ndarray, "m 3"]:
    """The points, or their means on a grid where there are more than `most_points`."""
    if len(points) <= most_points:
        return points
    return voxel_sample(torch.from_numpy(points), voxel)[0].numpy()


def align(
    source: Float[np.ndarray, "n 3"],
    target: Float[np.ndarray, "m 3"],
    T_start: Float[np.ndarray, "4 4"],
    *,
    kind: Literal["PLANE_ICP", "GICP"],
    distance: float,
    rounds: int,
    neighbors: int,
) -> Float[np.ndarray, "4 4"]:
    """The pose where small_gicp ends from `T_start`, with one thread."""
    clouds, trees = [], []
    for points in (source, target):
        cloud = small_gicp.PointCloud(np.ascontiguousarray(points))
        tree = small_gicp.KdTree(cloud)
        small_gicp.estimate_normals_covariances(
            cloud, tree, num_neighbors=min(neighbors, len(points)), num_threads=1
        )
        clouds.append(cloud)
        trees.append(tree)
    found = small_gicp.align(
        clouds[1],
        clouds[0],
        trees[1],
        init_T_target_source=T_start,
        registration_type=kind,
        max_correspondence_distance=distance,
        num_threads=1,
        max_iterations=rounds,
        # The library's own are those of a vehicle, a tenth of a degree and a millimeter.
        rotation_epsilon=1e-6,
        translation_epsilon=1e-6,
    )
    return rigid_or(np.array(found.T_target_source), T_start)
