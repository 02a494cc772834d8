"""Every descriptor is invariant to what it declares, and to nothing else."""

from __future__ import annotations

from dataclasses import asdict, fields

import numpy as np
import pytest
import torch

from fullturn.errors import InputError
from fullturn.features.traits import FEATURES, Invariance, assert_invariant
from fullturn.geometry.neighbors import knn

CHANGES = [field.name for field in fields(Invariance)]


def oriented_cloud(n: int = 200, *, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(seed)
    points, normals = torch.from_numpy(rng.standard_normal((2, n, 3)))
    # Dense enough for a radius of 0.1, and off the origin.
    return 0.08 * points + 0.05, normals / normals.norm(dim=-1, keepdim=True)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", FEATURES)
def test_declared_invariance_is_exact(name: str, change: str, seed: int) -> None:
    feature = FEATURES[name]
    points, normals = oriented_cloud(seed=seed)
    rng = np.random.default_rng(seed)
    if asdict(feature.invariance)[change]:
        assert_invariant(feature.compute, points, normals, to=change, rng=rng)
    else:
        with pytest.raises(AssertionError, match=f"not invariant to {change}"):
            # Not by rounding but truly: a tenth of the size of the features.
            assert_invariant(feature.compute, points, normals, to=change, rng=rng, tolerance=0.1)


@pytest.mark.parametrize("name", FEATURES)
def test_declared_channels(name: str) -> None:
    feature = FEATURES[name]
    points, normals = oriented_cloud()
    features = feature.compute(points, normals, knn(points, points, 5)[0])
    assert features.shape[0] == len(points)
    assert features.shape[-1] == feature.channels
    assert torch.isfinite(features).all()


@pytest.mark.parametrize("name", ["ppf", "ppf_folded", "rri"])
@pytest.mark.parametrize("change", ["rotation", "permutation"])
def test_invariance_in_float32(name: str, change: str) -> None:
    points, normals = oriented_cloud()
    assert_invariant(
        FEATURES[name].compute,
        points.float(),
        normals.float(),
        to=change,
        rng=np.random.default_rng(0),
    )


@pytest.mark.parametrize("change", CHANGES)
def test_the_check_fails_where_it_must(change: str) -> None:
    def leaky(
        points: torch.Tensor, normals: torch.Tensor, neighbor_index: torch.Tensor
    ) -> torch.Tensor:
        # Varies with everything: even a descriptor that depends on the row number is caught.
        rows = torch.arange(len(points), dtype=points.dtype)[:, None]
        return points + 0.01 * rows + 0.1 * normals

    points, normals = oriented_cloud()
    with pytest.raises(AssertionError, match=f"not invariant to {change}: channel"):
        assert_invariant(leaky, points, normals, to=change, rng=np.random.default_rng(0))


def test_a_nan_is_not_invariant() -> None:
    points, normals = oriented_cloud()
    with pytest.raises(AssertionError, match="not invariant"):
        assert_invariant(
            lambda points, normals, neighbor_index: points * torch.nan,
            points,
            normals,
            to="scale",
            rng=np.random.default_rng(0),
        )


def test_an_unknown_change_is_named() -> None:
    points, normals = oriented_cloud()
    with pytest.raises(InputError, match=r"rotation, translation, scale.*got 'color'"):
        assert_invariant(
            FEATURES["xyz"].compute, points, normals, to="color", rng=np.random.default_rng(0)
        )
