"""`locate`: the model is found alone, on a plane, twice; its frame and unit don't matter."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
import trimesh
from locate_scenes_of import model, moved, scan, square, uneven_ground
from scipy.spatial.transform import Rotation

import fullturn
from fullturn.data.motion import uniform_rotation
from fullturn.errors import InputError
from fullturn.evaluation.metrics import add
from fullturn.geometry.motion import invert, move, rigid
from fullturn.locating.judge import Judged, judge
from fullturn.locating.model import ModelConfig, PreparedModel, prepare
from fullturn.locating.search import LocateConfig


def error(T: np.ndarray, T_true: np.ndarray, prepared: PreparedModel) -> float:
    """ADD as a share of the diameter."""
    return add(T, T_true, prepared.points()) / prepared.diameter


@pytest.mark.parametrize("eye", [(2.0, 2.0, 1.0), (-2.5, 0.5, 0.5), (0.3, -2.0, 2.0)])
@pytest.mark.parametrize("known", [True, False])
def test_alone(dog_model: PreparedModel, eye: tuple[float, float, float], known: bool) -> None:
    points, viewpoint, T_true = scan([model()], eye, np.random.default_rng(1))
    found = fullturn.locate(dog_model, points, scene_viewpoint=viewpoint if known else None)
    assert error(found.T_scene_model, T_true, dog_model) < 0.02
    assert found.success_probability > 0.5
    assert found.success_probability <= found.surface_probability <= 1.0
    T = found.T_scene_model
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
    assert 0.1 < found.locations[0].visible_share < 0.7


@pytest.mark.parametrize("known", [True, False])
def test_on_a_support_plane(dog_model: PreparedModel, known: bool) -> None:
    floor = square(2.5, float(model().vertices[:, 2].min()))
    points, viewpoint, T_true = scan([model(), floor], (2.0, 1.5, 1.6), np.random.default_rng(2))
    found = fullturn.locate(dog_model, points, scene_viewpoint=viewpoint if known else None)
    assert error(found.T_scene_model, T_true, dog_model) < 0.02
    assert found.success_probability > 0.5


def test_beside_another_object(dog_model: PreparedModel) -> None:
    low = float(model().vertices[:, 2].min())
    ball = trimesh.creation.icosphere(radius=0.6)
    ball.apply_translation((-0.3, 1.8, low + 0.6))
    points, viewpoint, T_true = scan(
        [model(), square(3.0, low), ball], (2.6, 0.0, 2.0), np.random.default_rng(3)
    )
    found = fullturn.locate(dog_model, points, scene_viewpoint=viewpoint)
    assert error(found.T_scene_model, T_true, dog_model) < 0.02


def test_on_ground_that_hangs_together_with_it(dog_model: PreparedModel) -> None:
    ground = uneven_ground(4.0, float(model().vertices[:, 2].min()) + 0.05)
    points, viewpoint, T_true = scan(
        [model(), ground], (4.0, 0.5, 4.5), np.random.default_rng(4), pixels=120, reach=3.8
    )
    found = fullturn.locate(dog_model, points, scene_viewpoint=viewpoint)
    assert error(found.T_scene_model, T_true, dog_model) < 0.02
    assert found.surface_probability > 0.5


def test_two_instances(dog_model: PreparedModel) -> None:
    turn = Rotation.from_euler("z", 130.0, degrees=True).as_matrix()
    T_world = [rigid(np.eye(3), np.array([0.8, -0.9, 0])), rigid(turn, np.array([-0.8, 0.9, 0]))]
    dogs = [moved(model(), T) for T in T_world]
    floor = square(3.0, float(model().vertices[:, 2].min()))
    points, viewpoint, T_scene_world = scan(
        [*dogs, floor], (2.6, 1.6, 2.2), np.random.default_rng(4), pixels=150
    )
    found = fullturn.locate(dog_model, points, scene_viewpoint=viewpoint, instances=None)
    assert len(found.locations) == 2
    for T in T_world:
        errors = [
            error(place.T_scene_model, T_scene_world @ T, dog_model) for place in found.locations
        ]
        assert min(errors) < 0.02
    one = fullturn.locate(dog_model, points, scene_viewpoint=viewpoint)
    assert len(one.locations) == 1
    assert any((one.T_scene_model == place.T_scene_model).all() for place in found.locations)


def test_a_part_of_few_points_is_no_further_instance(
    dog_model: PreparedModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    def sure(*told: Any) -> Judged:
        judged = judge(*told)
        return dataclasses.replace(judged, surface=[0.9] * len(judged.surface))

    points, _, _ = scan([model()], (2.0, 2.0, 1.0), np.random.default_rng(1))
    away = np.linalg.norm(points - points[0], axis=1)
    piece = points[np.argsort(away)[: len(points) // 20]] + 5.0
    monkeypatch.setattr("fullturn.locating.locate.judge", sure)
    told: dict[str, Any] = {"instances": 2, "config": LocateConfig(sure=1.0)}
    both = np.vstack([points, piece])
    found = fullturn.locate(dog_model, both, min_probability=0.1, **told)
    assert [place.surface_probability for place in found.locations] == [0.9, pytest.approx(0.2)]
    found = fullturn.locate(dog_model, both, min_probability=0.5, **told)
    assert [place.surface_probability for place in found.locations] == [0.9]


@pytest.mark.parametrize("scale", [1000.0, 1e-3])
def test_moving_both_and_another_unit_give_the_same_pose(
    dog_model: PreparedModel, scale: float
) -> None:
    """T = g T h⁻¹ for a scene moved by g and a model moved by h, far from the origin."""
    points, _, T_true = scan([model()], (2.0, 2.0, 1.0), np.random.default_rng(1))
    rng = np.random.default_rng(5)
    g = rigid(uniform_rotation(rng), 100.0 * rng.normal(size=3))
    h = rigid(uniform_rotation(rng), 100.0 * rng.normal(size=3))
    other = moved(model(), h)
    other.vertices *= scale
    found = fullturn.locate(prepare(other, config=ModelConfig(views=20)), scale * move(g, points))
    T = found.T_scene_model.copy()
    T[:3, 3] /= scale
    assert error(invert(g) @ T @ h, T_true, dog_model) < 0.02


def test_a_complete_cloud_is_a_model_too(dog_model: PreparedModel) -> None:
    cloud, _ = trimesh.sample.sample_surface(model(), 8000, seed=0)
    points, viewpoint, T_true = scan([model()], (2.0, 2.0, 1.0), np.random.default_rng(1))
    found = fullturn.locate(np.asarray(cloud), points, scene_viewpoint=viewpoint)
    assert error(found.T_scene_model, T_true, dog_model) < 0.03


def test_something_else_is_improbable(dog_model: PreparedModel) -> None:
    box = trimesh.creation.box((1.3, 0.7, 0.4))
    points, viewpoint, _ = scan([box], (2.0, 2.0, 1.0), np.random.default_rng(6))
    found = fullturn.locate(dog_model, points, scene_viewpoint=viewpoint)
    assert found.surface_probability < 0.2


def test_turns_of_a_symmetric_model_share_the_probability() -> None:
    box = trimesh.creation.box((1.3, 0.8, 0.45))
    points, viewpoint, _ = scan([box], (2.0, 2.0, 1.5), np.random.default_rng(7))
    found = fullturn.locate(box, points, scene_viewpoint=viewpoint)
    first = found.locations[0]
    stated = [first.success_probability, *(o.success_probability for o in first.alternatives)]
    assert sum(stated) <= 1.0 + 1e-9
    assert len(stated) >= 4
    assert max(stated) < 0.6
    assert first.surface_probability > 0.5


def test_the_same_input_gives_the_same_bytes_and_stays_as_it_was(dog_model: PreparedModel) -> None:
    points, _, _ = scan([model()], (2.0, 2.0, 1.0), np.random.default_rng(8))
    before = points.copy()
    first, again = (fullturn.locate(dog_model, points.tolist()) for _ in range(2))
    np.testing.assert_array_equal(points, before)
    np.testing.assert_array_equal(first.T_scene_model, again.T_scene_model)
    assert first.surface_probability == again.surface_probability


def test_another_unit_is_said(dog_model: PreparedModel) -> None:
    points, _, _ = scan([model()], (2.0, 2.0, 1.0), np.random.default_rng(9))
    for scale in (1000.0, 1e-3):
        with pytest.raises(InputError, match="is the unit the same"):
            fullturn.locate(dog_model, scale * points)


@pytest.mark.parametrize(
    ("scene", "told", "message"),
    [
        (np.zeros((0, 3)), {}, "empty"),
        (np.full((30, 3), np.nan), {}, "finite"),
        (np.eye(3), {}, "at least 20 points"),
        (None, {"scene_viewpoint": (0, 1)}, "three finite numbers"),
        (None, {"scene_viewpoint": "here"}, "three numbers"),
        (None, {"instances": 0}, "at least 1"),
        (None, {"instances": True}, "at least 1"),
        (None, {"min_probability": 2.0}, "from 0 to 1"),
    ],
)
def test_bad_input_is_named(
    dog_model: PreparedModel, scene: np.ndarray | None, told: dict[str, object], message: str
) -> None:
    if scene is None:
        scene, _, _ = scan([model()], (2.0, 2.0, 1.0), np.random.default_rng(1), pixels=40)
    with pytest.raises(InputError, match=message):
        fullturn.locate(dog_model, scene, **told)  # type: ignore[arg-type]


@pytest.mark.usefixtures("unchecked")
def test_a_probability_that_is_no_number_is_named(dog_model: PreparedModel) -> None:
    with pytest.raises(InputError, match="from 0 to 1"):
        fullturn.locate(dog_model, np.eye(3), min_probability="a")  # type: ignore[arg-type]


def test_two_models_are_never_in_one_place(dog_model: PreparedModel) -> None:
    # Noise wider than the spacing leaves a shell of points that the model fits once more.
    rng = np.random.default_rng(5)
    points, viewpoint, _ = scan([model()], (2.0, 2.0, 1.0), rng, pixels=220)
    points = points + rng.normal(size=points.shape) * 0.02 * dog_model.diameter
    found = fullturn.locate(dog_model, points, scene_viewpoint=viewpoint, instances=None)
    assert len(found.locations) == 1


def test_a_stray_return_is_no_other_unit(dog_model: PreparedModel) -> None:
    points, viewpoint, _ = scan([model()], (2.0, 2.0, 1.0), np.random.default_rng(1))
    points[0] = (1e4, 0, 0)
    assert not fullturn.locate(dog_model, points, scene_viewpoint=viewpoint).notes
