"""Collinear clouds are refused at every place and scale, thin ones are not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from fullturn.errors import InputError
from fullturn.io import load_cloud
from fullturn.io.check import as_viewpoint

RNG = np.random.default_rng(0)
LINE = RNG.normal(size=(200, 1)) * np.array([[0.3, -0.5, 0.81]])
PLANE = RNG.normal(size=(200, 2)) @ np.array([[1.0, 0.2, 0.1], [0.3, -0.5, 0.8]])


@pytest.mark.parametrize("scale", [1e-100, 1e-6, 1.0, 1e6, 1e100])
@pytest.mark.parametrize("offset", [0.0, 1.0, 1e6])
@pytest.mark.parametrize("dtype", ["f8", "f4"])
def test_lines_are_refused_anywhere(scale: float, offset: float, dtype: str) -> None:
    if dtype == "f4":
        scale = np.clip(scale, 1e-20, 1e20)
    line = ((LINE + offset) * scale).astype(dtype)
    with pytest.raises(InputError, match=r"lie on one line|distinct"):
        load_cloud(line)


@pytest.mark.parametrize("scale", [1e-100, 1e-3, 1.0, 1e3, 1e100])
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_planes_are_accepted(scale: float, offset: float) -> None:
    load_cloud((PLANE + offset) * scale)


def test_thin_shapes_are_accepted_down_to_the_stated_limit() -> None:
    across = RNG.normal(size=(200, 1)) * np.array([[0.81, 0.0, -0.3]])
    load_cloud(LINE + 1e-5 * across)
    with pytest.raises(InputError, match="lie on one line"):
        load_cloud(LINE + 1e-7 * across)


def test_a_shape_that_single_precision_has_crushed_is_refused() -> None:
    far = (RNG.normal(size=(200, 3)) + 1e8).astype(np.float32)
    with pytest.raises(InputError, match=r"one line|distinct"):
        load_cloud(far)


def test_three_points_are_enough() -> None:
    load_cloud([[0, 0, 0], [1, 0, 0], [0, 1, 0]])


def test_coordinates_that_are_too_coarse_are_said_to_be() -> None:
    far = (PLANE + 5e6).astype("f4")
    with pytest.raises(InputError, match="save them in double precision"):
        load_cloud(far)


@pytest.mark.parametrize("far", [1e2, 1e4, 1e6, 1e8, 1e12, 1e100])
@pytest.mark.parametrize("first", [False, True])
def test_stray_points_make_nothing_a_line_and_no_line_a_shape(far: float, first: bool) -> None:
    stray = np.array([[0.3, 0.5, -0.8]]) * far
    assert len(load_cloud(np.vstack([stray, PLANE] if first else [PLANE, stray])).points) == 201
    with pytest.raises(InputError, match="all 200 lie on one line"):
        load_cloud(np.vstack([LINE, LINE[:1] * 100.0 * far]))


def test_a_stray_point_of_single_precision_is_no_coarse_cloud() -> None:
    load_cloud(np.vstack([PLANE, [[3e38, 0.0, 0.0]]]).astype("f4"))


@pytest.mark.parametrize("kind", [tuple, np.array, torch.tensor])
def test_a_viewpoint_may_be_of_any_kind_and_is_copied(kind: Callable[..., object]) -> None:
    given = kind([0.0, 1.0, 2.0])
    place = as_viewpoint(given, "viewpoint", frame="scene's")
    assert place is not None
    place += 1.0
    assert np.asarray(given).tolist() == [0.0, 1.0, 2.0]
