"""What a sensor at a known place must have seen, and what it can't know."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from pose_shapes import random_motions, teapot
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.pose.visibility import DepthImages

SPACING = 0.05
EYE = torch.tensor([0.0, 0.0, 4.0]).double()


def wall(half_width: float = 1.0) -> Tensor:
    """A square in z = 0, facing the eye."""
    line = torch.arange(-half_width, half_width + 1e-9, SPACING).double()
    return torch.cartesian_prod(line, line, torch.zeros(1).double())


def one(points: Tensor, eye: Tensor) -> DepthImages:
    return DepthImages(points, eye[None], spacing=SPACING)


def shares(image: DepthImages, *points: tuple[float, float, float]) -> list[float]:
    return image.violations(torch.tensor([points]).double())[0, 0].tolist()


def test_between_the_eye_and_the_wall_is_a_violation_behind_it_is_not() -> None:
    image = one(wall(), EYE)
    assert shares(image, (0.0, 0.0, 0.5)) == [1.0, 0.0, 0.0]
    assert shares(image, (0.1, -0.2, 3.0)) == [1.0, 0.0, 0.0]
    assert shares(image, (0.0, 0.0, -0.5)) == [0.0, 0.0, 0.0]
    assert shares(image, (0.4, 0.4, -9.0)) == [0.0, 0.0, 0.0]


def test_on_the_wall_and_within_the_margin_is_none() -> None:
    image = one(wall(), EYE)
    assert shares(image, (0.0, 0.0, 0.0), (0.0, 0.5, SPACING)) == [0.0, 0.0, 0.0]
    assert float(image.violations(wall()[None]).max()) == 0.0


def test_beside_the_wall_the_sensor_saw_nothing() -> None:
    image = one(wall(), EYE)
    assert shares(image, (1.3, 0.0, 0.0)) == [0.0, 1.0, 0.0]
    # A little beside the rim may be chance.
    assert shares(image, (1.0 + SPACING, 0.0, 0.0)) == [0.0, 0.0, 0.0]


def test_behind_the_eye_and_far_beside_the_sensor_may_not_have_looked() -> None:
    image = one(wall(), EYE)
    assert shares(image, (0.0, 0.0, 5.0), (0.1, 0.0, 4.0)) == [0.0, 0.0, 1.0]
    assert shares(image, (2.0, 0.0, 0.0), (0.0, 0.0, 0.0)) == [0.0, 0.0, 0.5]


def test_shares_are_means_over_the_points_and_a_batch_equals_the_loop() -> None:
    image = one(wall(), EYE)
    points = torch.tensor([[0, 0, 1], [0, 0, -1], [1.3, 0, 0], [0, 0, 0]]).double()
    batch = torch.stack([points, points.flip(0), points + 100.0, points * 0])
    found = image.violations(batch)[0]
    assert found.shape == (4, 3)
    torch.testing.assert_close(found[0], torch.tensor([0.25, 0.25, 0.0]).double())
    torch.testing.assert_close(found[2], torch.tensor([0.0, 0.0, 1.0]).double())
    for row, item in zip(found, batch, strict=True):
        torch.testing.assert_close(image.violations(item[None])[0, 0], row)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_view_moves_along_with_cloud_and_eye(dtype: torch.dtype) -> None:
    points, _ = teapot(2_000)
    eye = torch.tensor([1.5, 2.0, 1.0]).double()
    probes = torch.from_numpy(np.random.default_rng(0).uniform(-1, 1, (1, 3_000, 3)))
    expected = one(points, eye).violations(probes)
    assert float(expected.min()) > 0.02
    for T in random_motions(3, seed=1, length=2.0):
        image = one(rigid.apply(T, points).to(dtype), rigid.apply(T, eye[None])[0].to(dtype))
        # Pixels are laid anew, which moves what is near an edge.
        found = image.violations(rigid.apply(T, probes).to(dtype)).double()
        torch.testing.assert_close(found, expected, atol=0.03, rtol=0)


@pytest.mark.parametrize("distance", [1.5, 3.0, 100.0])
def test_a_scan_contradicts_itself_nowhere(distance: float) -> None:
    # The side of a ball that faces the eye.
    directions = torch.from_numpy(np.random.default_rng(2).normal(size=(3_000, 3)))
    ball = directions / directions.norm(dim=1, keepdim=True)
    eye = torch.tensor([0.0, distance, 0.0]).double()
    seen = ball[ball[:, 1] > 1 / distance]
    image = one(seen, eye)
    blocked, empty, outside = image.violations(seen[None])[0, 0].tolist()
    assert blocked < 0.02
    assert empty == 0.0
    if distance >= 3.0:  # nearer, the ball is wider than the image
        assert outside == 0.0


def test_a_wide_scan_contradicts_itself_nowhere() -> None:
    # A wall so near that it is seen under more than a right angle.
    near = torch.tensor([0.0, 0.0, 0.4]).double()
    image = one(wall(), near)
    blocked, empty, _ = image.violations(wall()[None])[0, 0].tolist()
    assert blocked < 0.02
    assert empty == 0.0


def test_a_scan_from_inside_contradicts_itself_nowhere() -> None:
    rng = np.random.default_rng(3)
    room = rng.uniform(-1, 1, (3_000, 3))
    axis = rng.integers(0, 3, 3_000)
    room[np.arange(3_000), axis] = rng.choice([-1.0, 1.0], 3_000)
    points = torch.from_numpy(room)
    eye = torch.tensor([0.1, 0.2, -0.1]).double()
    image = one(points, eye)
    blocked, empty, _ = image.violations(points[None])[0, 0].tolist()
    assert blocked < 0.02
    assert empty == 0.0


@pytest.mark.parametrize("place", ["mean", "a point", "far away"])
def test_odd_places_of_the_sensor_give_finite_shares(place: str) -> None:
    points = wall()
    eye = {"mean": points.mean(0), "a point": points[7], "far away": EYE * 1e6}[place]
    found = one(points, eye).violations(points[None])
    assert bool(torch.isfinite(found).all())
    assert math.isclose(float(found.clamp(0, 1).sum()), float(found.sum()))


def test_many_places_are_those_of_one_image_each() -> None:
    points, _ = teapot(1_500)
    eyes = 3.0 * torch.from_numpy(np.random.default_rng(4).normal(size=(6, 3)))
    probes = torch.from_numpy(np.random.default_rng(5).uniform(-1, 1, (4, 200, 3)))
    many = DepthImages(points, eyes, spacing=SPACING)
    found, hidden = many.violations(probes), many.hidden(points)
    assert found.shape == (6, 4, 3)
    for eye, expected, share in zip(eyes, found, hidden, strict=True):
        image = one(points, eye)
        torch.testing.assert_close(image.violations(probes)[0], expected)
        torch.testing.assert_close(image.hidden(points)[0], share)
    assert float(hidden.min()) > 0.05  # the back of the teapot


def test_what_one_sensor_saw_is_hidden_from_others() -> None:
    image = one(torch.cat([wall(0.5), wall(0.3) - torch.tensor([0.0, 0.0, 0.4])]), EYE)
    assert float(image.hidden(wall(0.5))) == 0.0
    assert float(image.hidden(wall(0.3) - torch.tensor([0.0, 0.0, 0.4]))) > 0.9
