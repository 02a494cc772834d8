"""The poses of a model in each part of a scene, found and measured."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.locating.model import PreparedModel
from fullturn.locating.part import take_part
from fullturn.locating.scene import SceneParts
from fullturn.locating.search import LocateConfig, find_poses
from fullturn.locating.verify import measure
from fullturn.pose.grid import NearestGrid
from fullturn.pose.kabsch import nearest_motion


@dataclass(frozen=True, eq=False)
class Candidates:
    """Distinct poses of the model in one part of a scene, the best by plain distances first."""

    T_scene_model: Float[Tensor, "k 4 4"]  # float64, model lengths, the scene's own origin
    features: Float[Tensor, "k f"]  # columns: `verify.FEATURES`
    explained: Bool[Tensor, "k n"]  # points of the part that lie on the model
    visible_share: Float[Tensor, " k"]  # of the model's surface that lies on the scene


def grid_of(model: PreparedModel) -> NearestGrid:
    """Nearest points of the model's surface, as far as matches and refinement look."""
    return NearestGrid(
        model.surface,
        model.normals,
        cell=0.75 * model.spacing,
        band=max(4.0 * model.spacing, 3.0 * model.levels[0].spacing, 0.12),
    )


def candidates(
    scene: SceneParts,
    members: Bool[Tensor, " n"],
    model: PreparedModel,
    model_grid: NearestGrid,
    config: LocateConfig,
) -> Candidates:
    """Find and measure the poses of the model in a part of the scene."""
    part = take_part(scene, members)
    T = find_poses(part, model, model_grid, config)
    measured = measure(T, part, model, model_grid, scene.planes)
    T = nearest_motion(T.double())
    T[:, :3, 3] += part.middle
    return Candidates(
        T,
        measured.features,
        measured.explained,
        measured.visible_share,
    )
