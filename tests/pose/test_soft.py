"""The soft pose is G6–G8 as written, and its gradients are finite where those divide by zero."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.matching.sinkhorn import sinkhorn
from fullturn.pose.kabsch import weighted_kabsch
from fullturn.pose.soft import soft_pose


def random_case(
    n: int = 12, m: int = 9, *, seed: int = 0, batch: int = 2
) -> tuple[Tensor, Tensor, Tensor]:
    rng = np.random.default_rng(seed)
    matching = torch.from_numpy(rng.uniform(size=(batch, n, m)) ** 8)
    return matching, *(torch.from_numpy(rng.normal(size=(batch, k, 3))) for k in (n, m))


def as_written(matching: Tensor, source: Tensor, target: Tensor) -> Tensor:
    confidence = matching.sum(-1)  # G6
    soft_target = matching @ target / confidence.unsqueeze(-1)  # G7
    return weighted_kabsch(source, soft_target, confidence)  # G8


def test_equals_the_formulas_and_their_gradients() -> None:
    weights = torch.arange(16.0).reshape(4, 4).double().sin()
    found = []
    for function in (soft_pose, as_written):
        inputs = [x.clone().requires_grad_() for x in random_case()]
        T = function(*inputs)
        (T * weights).sum().backward()
        found.append([T.detach(), *(x.grad for x in inputs)])
    for ours, theirs in zip(*found, strict=True):
        torch.testing.assert_close(ours, theirs, atol=1e-10, rtol=1e-9)


@pytest.mark.parametrize("angle_deg", [0.0, 1e-6, 60.0, 179.9999, 180.0])
@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (1e-3, 0.0), (1e3, 0.0), (1.0, 1e6)])
def test_a_permutation_gives_the_exact_pose(angle_deg: float, scale: float, offset: float) -> None:
    rng = np.random.default_rng(1)
    axis = torch.from_numpy(rng.normal(size=3))
    R = rigid.rotation_from_axis_angle(axis, torch.tensor(np.radians(angle_deg)))
    source = torch.from_numpy(rng.normal(size=(1, 30, 3))) * scale + offset
    T = rigid.make(R, torch.from_numpy(rng.normal(size=3)) * scale)[None]
    order = torch.from_numpy(rng.permutation(30))
    target = rigid.apply(T, source)[:, order]
    matching = torch.eye(30, dtype=torch.float64)[None, :, order]
    found = soft_pose(matching, source, target)
    torch.testing.assert_close(found[:, :3, :3], T[:, :3, :3], atol=1e-9, rtol=0)
    moved = rigid.apply(found, source)[:, order]
    torch.testing.assert_close(moved, target, atol=1e-8 * max(scale, 1e-3), rtol=1e-12)


def test_the_scale_of_the_matching_is_of_no_matter() -> None:
    matching, source, target = (x.float() for x in random_case(seed=2))
    expected = soft_pose(matching, source, target)
    for scale in (1e-12, 1e-3, 1e6):
        found = soft_pose(scale * matching, source, target)
        torch.testing.assert_close(found, expected, atol=1e-5, rtol=0)


def test_padding_and_points_without_mass_change_nothing() -> None:
    matching, source, target = random_case(seed=3)
    expected = soft_pose(matching, source, target)
    padded = torch.nn.functional.pad(matching, (0, 4, 0, 5))
    more_source = torch.cat([source, 1e17 + source[:, :5]], 1)
    more_target = torch.cat([target, target[:, :1].expand(2, 4, 3)], 1)
    torch.testing.assert_close(soft_pose(padded, more_source, more_target), expected)


def test_a_batch_equals_the_loop() -> None:
    matching, source, target = random_case(batch=5, seed=4)
    together = soft_pose(matching, source, target)
    for i in range(5):
        one = slice(i, i + 1)
        torch.testing.assert_close(
            soft_pose(matching[one], source[one], target[one]), together[one]
        )


def degenerate(dtype: torch.dtype) -> dict[str, tuple[Tensor, Tensor, Tensor]]:
    rng = np.random.default_rng(5)
    cloud = torch.from_numpy(rng.normal(size=(1, 8, 3))).to(dtype)
    line = cloud[..., :1] * torch.tensor([0.3, -0.4, 0.5], dtype=dtype)
    plane = cloud * torch.tensor([1.0, 1.0, 0.0], dtype=dtype)
    mirror = cloud * torch.tensor([1.0, 1.0, -1.0], dtype=dtype)
    eye = torch.eye(8, dtype=dtype)[None]
    even = torch.ones_like(eye)
    point = cloud[:, :1].expand(1, 8, 3)
    one_pair = torch.zeros_like(eye)
    one_pair[0, 3, 4] = 1.0
    vanishing = eye * torch.logspace(0, -44, 8, dtype=torch.float64).to(dtype)
    return {
        "coplanar": (eye, plane, plane.roll(1, -1)),
        "collinear": (eye, line, line.roll(1, -1)),
        "collinear far away": (eye, line + 1e4, line.roll(1, -1) - 1e4),
        "collinear against a cloud": (eye, line, cloud),
        "coincident": (eye, point, point + 1.0),
        "coincident target": (eye, cloud, point),
        "coincident far away": (eye, point * 1e5 + 0.1, cloud),
        "all zero": (eye, cloud * 0, cloud * 0),
        "reflection": (eye, cloud, mirror),
        "everything on one target": (even * (torch.arange(8) == 2), cloud, cloud),
        "everything from one source": ((even * (torch.arange(8) == 2)).mT, cloud, cloud),
        "one pair": (one_pair, cloud, cloud),
        "even": (even, cloud, cloud.flip(1)),
        "no mass": (eye * 0, cloud, cloud),
        "hardly any mass": (eye * 1e-40, cloud, cloud),
        "vanishing confidences": (vanishing, cloud, cloud.flip(1)),
        "duplicates": (eye, cloud[:, [0, 0, 1, 1, 2, 2, 3, 3]], cloud[:, [0, 0, 1, 1, 2, 2, 3, 3]]),
        "cube corners": (
            eye[:, :3, :3],
            torch.eye(3).to(dtype)[None],
            -torch.eye(3).to(dtype)[None],
        ),
        "tiny": (eye, cloud * 1e-12, cloud.flip(1) * 1e-12),
    }


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("case", sorted(degenerate(torch.float64)))
def test_degenerate_cases_give_a_rigid_pose_and_finite_gradients(
    case: str, dtype: torch.dtype
) -> None:
    inputs = [x.clone().requires_grad_() for x in degenerate(dtype)[case]]
    T = soft_pose(*inputs)
    R = T.detach()[:, :3, :3]
    precision = 1e-5 if dtype == torch.float32 else 1e-12
    torch.testing.assert_close(R @ R.mT, torch.eye(3).to(R)[None], atol=precision, rtol=0)
    torch.testing.assert_close(torch.linalg.det(R), torch.ones(1).to(R), atol=precision, rtol=0)
    (T * torch.arange(16.0).reshape(4, 4).to(dtype).sin()).sum().backward()
    for value in inputs:
        assert value.grad is not None
        assert bool(torch.isfinite(value.grad).all())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    "case", ["even", "everything on one target", "coincident", "one pair", "no mass"]
)
def test_what_the_matching_leaves_open_is_the_identity(case: str, dtype: torch.dtype) -> None:
    """Rounding must not choose a rotation, least of all with a gradient of its reciprocal."""
    matching, source, target = degenerate(dtype)[case]
    source = source.clone().requires_grad_()
    R = soft_pose(matching, source, target)[:, :3, :3]
    torch.testing.assert_close(R.detach(), torch.eye(3).to(R)[None], atol=1e-6, rtol=0)
    (R * torch.arange(9.0).reshape(3, 3).to(dtype).sin()).sum().backward()
    assert source.grad is not None
    assert float(source.grad.abs().max()) == 0.0


def test_gradcheck() -> None:
    assert torch.autograd.gradcheck(
        soft_pose, [x.requires_grad_() for x in random_case(4, 5, seed=6)], atol=1e-6
    )
    for case in ("coplanar", "duplicates", "cube corners"):
        inputs = [x[..., :6, :].clone() for x in degenerate(torch.float64)[case]]
        inputs[0] = inputs[0][..., : inputs[2].shape[1]]
        assert torch.autograd.gradcheck(soft_pose, [x.requires_grad_() for x in inputs], atol=1e-6)


def test_gradcheck_from_scores_to_pose() -> None:
    rng = np.random.default_rng(7)
    source, target = (torch.from_numpy(rng.normal(size=(1, k, 3))) for k in (5, 4))
    scores = torch.from_numpy(rng.normal(size=(1, 5, 4))).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda x: soft_pose(sinkhorn(x), source, target), (scores,), atol=1e-6
    )


def test_points_far_from_any_match_still_pull() -> None:
    """Where a confidence underflows, the division of G7 would give NaN; the gradient is exact."""
    rng = np.random.default_rng(8)
    source, target = (torch.from_numpy(rng.normal(size=(1, 6, 3))).float() for _ in range(2))
    scores = torch.from_numpy(rng.normal(size=(1, 6, 6))).float()
    scores[:, 2] -= 95.0
    found = []
    for dtype in (torch.float32, torch.float64):
        matching = sinkhorn(scores.to(dtype)).detach().requires_grad_()
        soft_pose(matching, source.to(dtype), target.to(dtype))[:, :3].sum().backward()
        assert matching.grad is not None
        found.append(matching.grad.double())
    assert float(matching.detach()[0, 2].max()) < torch.finfo(torch.float32).tiny
    torch.testing.assert_close(*found, atol=1e-4, rtol=1e-3)


def test_nan_comes_out_as_nan_and_stops_nothing() -> None:
    """A network that has diverged is for the training loop to notice, pair by pair."""
    matching, source, target = random_case(seed=9)
    expected = soft_pose(matching, source, target)
    matching[0, 2, 3] = torch.nan
    T = soft_pose(matching, source, target)
    assert bool(T[0].isnan().any())
    torch.testing.assert_close(T[1], expected[1])
