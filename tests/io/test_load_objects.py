"""Objects are taken as they are, never modified, and refused in one clear line."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from fullturn.errors import InputError
from fullturn.io import LoadedCloud, load_cloud

POINTS = np.random.default_rng(0).integers(-100, 100, size=(30, 3)).astype(np.float64)


def open3d_cloud() -> Any:
    o3d = pytest.importorskip("open3d")
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(POINTS))


@pytest.mark.parametrize(
    "make",
    [
        lambda: POINTS,
        lambda: POINTS.astype(np.float32),
        lambda: POINTS.astype(np.int16),
        lambda: np.asfortranarray(POINTS),
        lambda: POINTS[::-1][::-1],
        lambda: POINTS.tolist(),
        lambda: tuple(map(tuple, POINTS.tolist())),
        lambda: list(POINTS),
        lambda: torch.from_numpy(POINTS),
        lambda: torch.from_numpy(POINTS).float().requires_grad_(),
        lambda: torch.from_numpy(POINTS).bfloat16(),
        lambda: torch.from_numpy(POINTS).long(),
        lambda: SimpleNamespace(points=POINTS),
        lambda: SimpleNamespace(vertices=POINTS.tolist()),
        lambda: SimpleNamespace(points=torch.from_numpy(POINTS)),
        lambda: LoadedCloud(POINTS),
        lambda: pytest.importorskip("trimesh").PointCloud(POINTS),
        open3d_cloud,
    ],
)
def test_every_accepted_object(make: Any) -> None:
    thing = make()
    loaded = load_cloud(thing)
    np.testing.assert_array_equal(loaded.points, POINTS)
    assert loaded.points.dtype == np.float64
    assert loaded.points.flags.c_contiguous
    loaded.points[:] = 0.0  # its own memory: the input stays
    np.testing.assert_array_equal(load_cloud(thing).points, POINTS)


def test_meshes_in_memory_are_sampled() -> None:
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere()
    for thing in (ball, trimesh.Scene([ball])):
        loaded = load_cloud(thing, samples=1000, name="source")
        assert loaded.points.shape == (1000, 3)
        assert "source: sampled 1000 points" in loaded.notes[0]
        radius = np.linalg.norm(loaded.points, axis=1)
        assert radius.min() > 0.97
        assert radius.max() <= 1.0 + 1e-12


@pytest.mark.parametrize(
    ("thing", "message"),
    [
        (None, "a file path, an .N, 3. array"),
        (7, "a file path, an .N, 3. array"),
        ({"points": 1}, "a file path, an .N, 3. array"),
        (object(), "a file path, an .N, 3. array"),
        (b"cloud.ply", "a file path, an .N, 3. array"),
        ([], "it is empty"),
        (np.zeros((0, 3)), "it is empty"),
        (POINTS[:, :2], r"found \(30, 2\)"),
        (POINTS.T, "transpose it"),
        (np.zeros(3), r"found \(3,\)"),
        (POINTS[None], "batch"),
        (POINTS + 1j, "complex128"),
        (POINTS.astype(str), "dtype <U"),
        (POINTS.astype(object), "dtype object"),
        (POINTS > 0, "dtype bool"),
        ([[1, 2, 3], [4, 5]], "cannot make an array"),
        ([["a", "b", "c"]] * 4, "dtype <U1"),
        (torch.zeros(5, 3, dtype=torch.complex64), "complex64"),
        (torch.zeros(5, 3, device="meta"), "dense tensor"),
        (torch.eye(3).to_sparse(), "dense tensor"),
        (np.ma.masked_less(POINTS, 0), "unmasked"),
        (POINTS[:2], "found 2 among 2"),
        (np.tile(POINTS[:2], (9, 1)), "found 2 among 18"),
        (np.ones((5, 3)), "found 1 among 5"),
        (SimpleNamespace(points=None), "a file path, an .N, 3. array"),
        (np.where(POINTS[4, 1] == POINTS, np.nan, POINTS), "NaN or infinity, the first in row"),
        (POINTS * 1e200, "rescale it"),
        (POINTS * 1e-200, "rescale it"),
    ],
)
def test_every_refusal_says_what_came(thing: Any, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        load_cloud(thing, name="target")
    assert str(caught.value).startswith("target: expected")
    assert "\n" not in str(caught.value)
