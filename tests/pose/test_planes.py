"""Planes of coordinates hold the same numbers as rows of points."""

from __future__ import annotations

import numpy as np
import torch

from fullturn.geometry import rigid
from fullturn.pose.planes import move_planes, squared_falloff


def test_moving_planes_is_moving_rows() -> None:
    rng = np.random.default_rng(0)
    points = torch.from_numpy(rng.normal(size=(50, 3)))
    T = rigid.make(
        rigid.random_rotations_uniform(7, rng=rng), torch.from_numpy(rng.normal(size=(7, 3)))
    )
    found = move_planes(T, points.T)
    torch.testing.assert_close(found.permute(1, 2, 0), rigid.apply(T, points))


def test_falloff() -> None:
    lengths = torch.tensor([0.0, 1.0, 2.0, 3.0])
    expected = torch.tensor([1.0, 0.75, 0.0, 0.0])
    torch.testing.assert_close(squared_falloff(lengths.square(), 2.0), expected)
