"""What is measured of a pose: of a box in its own view, at its place and off it."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from fullturn.locating.candidates import grid_of
from fullturn.locating.model import PreparedModel
from fullturn.locating.part import take_part
from fullturn.locating.planes import Plane
from fullturn.locating.scene import SceneParts
from fullturn.locating.verify import FEATURES, measure
from fullturn.locating.views import DISTANCE


def measured(
    model: PreparedModel, *, known: bool, planes: list[Plane] | None = None
) -> tuple[dict[str, Tensor], Tensor, Tensor]:
    """A view as the scan; the model at its place, 0.4 nearer to the eye, and 0.4 farther."""
    view = 0
    points = model.surface[model.seen[view]].double()
    direction = model.directions[view]
    viewpoint = (DISTANCE * direction).double() if known else None
    scene = SceneParts(points, model.spacing, viewpoint, planes or [])
    part = take_part(scene, torch.ones(len(points), dtype=torch.bool))
    T = torch.eye(4).repeat(3, 1, 1)
    T[:, :3, 3] = torch.tensor([[0.0], [0.4], [-0.4]]) * direction - part.middle.float()
    found = measure(T, part, model, grid_of(model), scene.planes)
    columns = dict(zip(FEATURES, found.features.T, strict=True))
    return columns, found.explained, found.visible_share


@pytest.mark.parametrize("known", [True, False])
def test_a_view_lies_on_its_model(box_model: PreparedModel, known: bool) -> None:
    found, explained, visible_share = measured(box_model, known=known)
    assert bool(explained[0].all())
    assert float(found["part_near"][0]) == pytest.approx(1.0)
    assert float(found["part_far"][0]) == 0.0
    assert float(found["part_normals"][0]) < 0.1
    assert float(found["seen_near"][0]) > 0.9
    assert float(visible_share[0]) == pytest.approx(float(found["seen_share"][0]), abs=0.05)
    for name in ("part_one", "part_three", "seen_one", "seen_three"):
        assert int(found[name].argmin()) == 0, name
    assert float(found["part_near"][1:].max()) < 0.7
    assert torch.allclose(
        found["log_points"].exp(), torch.tensor(float(explained.shape[1])), rtol=1e-4
    )


def test_the_sensor_saw_past_what_is_before_the_scan_and_not_what_is_behind(
    box_model: PreparedModel,
) -> None:
    found, _, _ = measured(box_model, known=True)
    assert found["sight_known"].tolist() == [1.0, 1.0, 1.0]
    assert float(found["past"][0]) < 0.05
    assert float(found["hidden"][0]) < 0.05
    assert float(found["past"][1]) > 0.4
    assert float(found["hidden"][2]) > 0.4


def test_without_a_viewpoint_nothing_is_said_of_what_it_saw(box_model: PreparedModel) -> None:
    found, _, _ = measured(box_model, known=False)
    for name in ("past", "empty", "hidden", "sight_known"):
        assert found[name].tolist() == [0.0, 0.0, 0.0], name


def test_what_lies_below_a_plane_is_counted(box_model: PreparedModel) -> None:
    normal = torch.tensor([0.0, 0.0, 1.0]).double()
    some = int(box_model.seen[0].sum())
    through = Plane(normal, 0.0, 0.01, torch.zeros(some, dtype=torch.bool))
    found, _, _ = measured(box_model, known=True, planes=[through])
    assert float(found["below"][0]) == pytest.approx(0.45, abs=0.1)
    depth = -float(box_model.surface[:, 2].min())
    assert float(found["below_depth"][0]) == pytest.approx(depth, abs=1e-3)
    none, _, _ = measured(box_model, known=True)
    assert not bool(none["below"].any())
