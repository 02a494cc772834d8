"""Overlap: known shares, symmetry between the clouds, invariance to a common motion."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.distance import cdist

from fullturn.errors import InputError
from fullturn.geometry import rigid
from fullturn.geometry.overlap import overlap, overlap_masks


def pair() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(0)
    shape = torch.from_numpy(rng.standard_normal((300, 3)))
    T = rigid.make(
        rigid.random_rotations_uniform(1, rng=rng)[0], torch.from_numpy(rng.standard_normal(3))
    )
    return shape[:200], rigid.apply(T, shape[150:]), T


def test_masks_by_definition() -> None:
    source, target, T = pair()
    near = cdist(rigid.apply(T, source), target) <= 0.2
    source_mask, target_mask = overlap_masks(source, target, T, distance=0.2)
    assert torch.equal(source_mask, torch.from_numpy(near.any(axis=1)))
    assert torch.equal(target_mask, torch.from_numpy(near.any(axis=0)))


def test_shares_of_a_known_overlap() -> None:
    source, target, T = pair()
    assert overlap(source, target, T, distance=1e-9) == (50 / 200, 50 / 150)
    assert overlap(source, target, T, distance=1e9) == (1.0, 1.0)


def test_swapping_the_clouds_swaps_the_shares() -> None:
    source, target, T = pair()
    forward = overlap(source, target, T, distance=0.3)
    backward = overlap(target, source, rigid.invert(T), distance=0.3)
    assert forward == backward[::-1]


def test_a_common_motion_changes_nothing() -> None:
    source, target, T = pair()
    shift = torch.tensor([1e6, 0.0, 0.0], dtype=torch.float64)
    moved_T = rigid.compose(rigid.make(torch.eye(3, dtype=torch.float64), shift), T)
    assert overlap(source, target + shift, moved_T, distance=0.3) == overlap(
        source, target, T, distance=0.3
    )


def test_negative_distance_is_named() -> None:
    source, target, T = pair()
    with pytest.raises(InputError, match="must not be negative, got -1"):
        overlap(source, target, T, distance=-1.0)
