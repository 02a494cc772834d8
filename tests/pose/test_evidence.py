"""What keypoints say of a pose: by hand, and what must not change it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from pose_shapes import level_of, perturbations, random_motions, teapot
from scipy.spatial import cKDTree
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.pose import evidence as module
from fullturn.pose.contact import contacts, prepare_surface
from fullturn.pose.evidence import SIGNALS, PointSignals, evidence, point_signals
from fullturn.pose.levels import Level, LevelPair
from fullturn.pose.verify import likenesses

H = 0.08
T_TRUE = random_motions(1, seed=1)[0]
EYES = (torch.tensor([0.5, 3.0, 1.0]).double(), torch.tensor([-0.5, -3.0, 1.0]).double())


def part(count: int, seed: int, T: Tensor) -> Level:
    points, normals = teapot(count, seed)
    kept = points[:, 1] > -0.2 if seed % 2 else points[:, 1] < 0.2
    points, normals = rigid.apply(T, points[kept]), normals[kept] @ T[:3, :3].mT
    return level_of(points, normals)


def measured(
    T: Tensor, g: Tensor | None = None, h: Tensor | None = None, *, eyes: bool = False
) -> PointSignals:
    """The signals of two parts of the teapot, moved by g and T_TRUE, then h."""
    unmoved = torch.eye(4).double()
    g, h = unmoved if g is None else g, unmoved if h is None else h
    motions = g, h @ T_TRUE
    levels = part(700, 1, motions[0]), part(420, 2, motions[1])
    pair = LevelPair(*levels, H)
    # As good descriptors would have it: points are alike that belong together.
    keypoints = [level.points[level.keypoints] for level in levels]
    together = rigid.apply(h @ T_TRUE @ rigid.invert(g), keypoints[0])
    alike = (-torch.cdist(together, keypoints[1]).square() / (2 * H) ** 2).exp()
    seen = [rigid.apply(m, eye[None])[0] for m, eye in zip(motions, EYES, strict=True)]
    surfaces = [
        prepare_surface(level, spacing=H, viewpoint=eye if eyes else None)
        for level, eye in zip(levels, seen, strict=True)
    ]
    T = h @ T @ rigid.invert(g)
    return point_signals(contacts(T, *surfaces), likenesses(T, pair, alike), pair, pair)


def column(signals: PointSignals, name: str) -> Tensor:
    return signals.values[..., SIGNALS.index(name)]


@pytest.mark.parametrize("eyes", [False, True])
def test_no_frame_changes_them(eyes: bool) -> None:
    T = T_TRUE @ perturbations(4, seed=5, angle_deg=10.0, length=0.05)
    g, h = random_motions(2, seed=6)
    plain, moved = measured(T, eyes=eyes), measured(T, g, h, eyes=eyes)
    # Pixels lie along other axes; a point on the edge of one may fall to either side.
    same = (plain.values - moved.values).abs() < 1e-4
    assert float(same.double().mean()) > (0.98 if eyes else 0.9999)
    torch.testing.assert_close(plain.area, moved.area)
    assert bool((column(plain, "seen")[plain.area > 0] == float(eyes)).all())


def test_distances_heights_and_patches_by_hand() -> None:
    T = T_TRUE @ perturbations(1, seed=7, angle_deg=8.0, length=0.03)
    found = measured(T)
    own, other = part(700, 1, torch.eye(4).double()), part(420, 2, T_TRUE)
    points = rigid.apply(T[0], own.points).numpy()
    distance, partner = cKDTree(other.points.numpy()).query(points)
    normals = other.normals.numpy()[partner]
    height = ((points - other.points.numpy()[partner]) * normals).sum(1)
    cosine = ((own.normals @ T[0, :3, :3].mT).numpy() * normals).sum(1)
    near = distance < 1.5 * H
    around = cKDTree(own.points.numpy()).query(own.points.numpy(), k=12)[1]
    rows = own.keypoints.numpy()[::2]  # every second one is heard
    expected = {
        "distance": np.minimum(distance / H, 4),
        "height": np.clip(height / H, -3, 3),
        "normals": cosine,
        "near": near,
        "patch_near": near[around].mean(1),
    }
    for name, values in expected.items():
        np.testing.assert_allclose(column(found, name)[0, 0, : len(rows)], values[rows], atol=1e-6)


def test_the_smaller_cloud_is_filled_up_with_nothing() -> None:
    found = measured(T_TRUE[None])
    assert found.values.shape[:3] == found.area.shape
    assert found.values.shape[-1] == len(SIGNALS) == len(set(SIGNALS))
    empty = found.area == 0
    assert bool(empty.any())
    assert bool((found.values[empty] == 0).all())
    assert bool(torch.isfinite(found.values).all())


def test_the_right_pose_has_the_most_evidence() -> None:
    wrong = T_TRUE @ perturbations(8, seed=8, angle_deg=60.0, length=0.1)
    found = measured(torch.cat([T_TRUE[None], wrong]))
    said = evidence(PointSignals(found.values.float(), found.area.float()))
    assert said.shape == (9, 1)
    assert int(said.argmax()) == 0


def test_without_weights_nothing_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "load_evidence_net", lambda: None)
    found = evidence(measured(T_TRUE[None]))
    assert found.shape == (1, 1)
    assert bool(found.isnan().all())
