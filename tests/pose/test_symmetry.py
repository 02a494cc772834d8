"""Symmetries from rival poses of known groups, and of clouds of known shapes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from pose_shapes import perturbations, random_motions
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.pose.symmetry import symmetry_of_poses

AXIS = torch.tensor([0.6, 0.0, 0.8]).double()
CENTER = torch.tensor([0.1, -0.2, 0.05]).double()
T_BEST = random_motions(1, seed=1)[0]


def turns(*angles_deg: float, axis: Tensor = AXIS, noise_deg: float = 0.0) -> Tensor:
    """Turns about an axis through CENTER, put behind the best pose."""
    angles = torch.tensor(angles_deg).double()
    R = rigid.rotation_from_axis_angle(axis.expand(len(angles), 3), angles.deg2rad())
    T = rigid.make(R, CENTER - R @ CENTER)
    shake = perturbations(len(angles), seed=2, angle_deg=noise_deg, length=1e-3 * noise_deg)
    return T_BEST @ T @ shake


def steps(order: int) -> Tensor:
    return turns(*(360.0 * k / order for k in range(1, order)), noise_deg=1.0)


@pytest.mark.parametrize("order", [2, 3, 4, 5, 6, 8])
def test_n_fold(order: int) -> None:
    found = symmetry_of_poses(T_BEST, steps(order))
    assert found is not None
    assert found.order == order


@pytest.mark.parametrize(("angle_deg", "order"), [(180.0, 2), (120.0, 3)])
def test_one_rival_is_enough_for_a_low_order(angle_deg: float, order: int) -> None:
    found = symmetry_of_poses(T_BEST, turns(angle_deg))
    assert found is not None
    assert found.order == order


def test_the_axis_has_one_sign() -> None:
    for sign in (1.0, -1.0):
        found = symmetry_of_poses(T_BEST, turns(180.0, 90.0, 270.0, axis=sign * AXIS))
        assert found is not None
        np.testing.assert_allclose(found.axis, AXIS, atol=1e-6)


def test_any_angle_is_continuous() -> None:
    found = symmetry_of_poses(T_BEST, turns(13.0, 40.0, 75.0, 110.0, 200.0, 300.0))
    assert found is not None
    assert found.order == 0
    np.testing.assert_allclose(found.axis, AXIS, atol=1e-6)


def test_no_rivals_no_symmetry() -> None:
    assert symmetry_of_poses(T_BEST, T_BEST.new_empty(0, 4, 4)) is None


def test_slides_are_no_symmetry() -> None:
    slid = T_BEST.repeat(3, 1, 1)
    slid[:, 0, 3] += torch.tensor([0.1, 0.2, -0.3]).double()
    assert symmetry_of_poses(T_BEST, slid) is None


def test_the_three_half_turns_of_a_box_are_a_symmetry() -> None:
    rivals = torch.cat([turns(180.0, axis=axis, noise_deg=1.0) for axis in torch.eye(3).double()])
    found = symmetry_of_poses(T_BEST, rivals)
    assert found is not None
    assert found.order == 2
    np.testing.assert_allclose(found.axis, [1, 0, 0], atol=0.03)


def test_rivals_about_many_axes_share_none() -> None:
    axes = torch.eye(3).double()
    rivals = torch.cat(
        [turns(180.0, axis=axis) for axis in (*axes, *(axes + 0.7 * axes.roll(1, 0)))]
    )
    assert symmetry_of_poses(T_BEST, rivals) is None


@pytest.mark.parametrize("angle_deg", [6.0, 8.0, 11.0, 100.0, 150.0])
def test_one_odd_angle_is_no_symmetry(angle_deg: float) -> None:
    assert symmetry_of_poses(T_BEST, turns(angle_deg)) is None


def test_the_target_frame_is_nothing() -> None:
    h = random_motions(1, seed=3)[0]
    here, there = (symmetry_of_poses(g @ T_BEST, g @ steps(4)) for g in (torch.eye(4).double(), h))
    assert here is not None
    assert there is not None
    assert here.order == there.order
    np.testing.assert_allclose(here.axis, there.axis, atol=1e-9)
