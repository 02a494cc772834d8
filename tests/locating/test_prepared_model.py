"""Preparing: only the outside, normals outward; files read back to the same answers."""

from __future__ import annotations

import dataclasses
from collections.abc import Set
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from locate_scenes_of import model, scan
from safetensors.numpy import load_file, save_file

import fullturn
from fullturn.errors import InputError, ReadError, WriteError
from fullturn.locating import store
from fullturn.locating.model import ModelConfig, PreparedModel, prepare
from fullturn.locating.views import visible

SMALL = ModelConfig(views=12, level_points=(200,))


def assert_identical(one: Any, other: Any, *, besides: Set[str] = frozenset()) -> None:
    """All fields of two dataclasses."""
    for name in {field.name for field in dataclasses.fields(one)} - besides:
        mine, its = getattr(one, name), getattr(other, name)
        if isinstance(mine, torch.Tensor):
            assert torch.equal(mine, its), name
            assert mine.dtype == its.dtype, name
        else:
            assert mine == its, name


def test_the_inside_is_left_out_and_normals_point_outward() -> None:
    ball, core = trimesh.creation.icosphere(radius=2.0), trimesh.creation.icosphere(radius=1.0)
    prepared = prepare(trimesh.util.concatenate([ball, core]), config=SMALL)
    length = prepared.surface.norm(dim=1)
    assert float(length.min()) > 0.9  # normalized: the core would be at one half
    cosine = (prepared.normals * prepared.surface).sum(1) / length
    assert float(cosine.min()) > 0.8
    assert prepared.diameter == pytest.approx(4.0, rel=0.01)
    # A view from three radii sees a third of a ball, less what it sees at a grazing angle.
    assert 0.22 < float(prepared.seen.float().mean()) < 0.36


def test_a_cloud_is_seen_as_its_mesh_is() -> None:
    cloud, _ = trimesh.sample.sample_surface(model(), 10_000, seed=0)
    from_cloud, from_mesh = (prepare(m, config=SMALL) for m in (np.asarray(cloud), model()))
    there = torch.from_numpy(from_mesh.points())
    distance = torch.cdist(torch.from_numpy(from_cloud.points()), there).amin(1)
    assert float(distance.quantile(0.99)) < 0.05 * from_mesh.diameter
    shares = [float(p.seen.float().mean()) for p in (from_cloud, from_mesh)]
    assert shares[0] == pytest.approx(shares[1], abs=0.1)


def test_a_stray_point_of_a_cloud_is_left_out_and_named() -> None:
    cloud = np.asarray(trimesh.sample.sample_surface(model(), 4_000, seed=0)[0])
    stray = prepare(np.vstack([cloud, [[50.0, 0.0, 0.0]]]), config=SMALL)
    assert stray.radius == prepare(cloud, config=SMALL).radius
    assert "model: left out 1 point(s) far from the rest" in stray.notes


def test_visible_points_are_those_of_the_near_half() -> None:
    points = torch.from_numpy(np.array(trimesh.creation.icosphere(subdivisions=5).vertices))
    eye = torch.tensor([0.0, 0.0, 3.0]).double()
    seen = visible(points, eye, pixel=0.1, margin=0.15)
    assert seen[points[:, 2] > 0.7].all()
    assert not seen[points[:, 2] < 0.0].any()


def test_a_sheet_has_two_sides() -> None:
    sheet = trimesh.creation.box((1.0, 1.0, 0.02))
    prepared = prepare(sheet, config=SMALL)
    up = prepared.normals[:, 2]
    assert float((up > 0.9).float().mean()) > 0.2
    assert float((up < -0.9).float().mean()) > 0.2


def test_a_file_gives_the_identical_result(dog_model: PreparedModel, tmp_path: Path) -> None:
    path = tmp_path / "dog.safetensors"
    dog_model.save(path)
    again = store.load_prepared(path, model=model())
    assert_identical(dog_model, again, besides={"levels"})
    for level, its in zip(dog_model.levels, again.levels, strict=True):
        assert_identical(level, its)
    points, viewpoint, _ = scan([model()], (2.0, 2.0, 1.0), np.random.default_rng(1))
    first = fullturn.locate(dog_model, points, scene_viewpoint=viewpoint)
    second = fullturn.locate(path, points, scene_viewpoint=viewpoint)
    np.testing.assert_array_equal(first.T_scene_model, second.T_scene_model)
    assert first.success_probability == second.success_probability


def test_without_the_descriptors_weights_it_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fullturn.locating.describe.load_surface_net", lambda: None)
    prepared = prepare(model(), config=SMALL)
    assert prepared.notes == (
        "no descriptor weights in the package: matched by handcrafted histograms",
    )
    points, _, _ = scan([model()], (2.0, 2.0, 1.0), np.random.default_rng(1))
    assert prepared.notes[0] in fullturn.locate(prepared, points).notes


def test_wrong_files_are_refused(
    dog_model: PreparedModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, other = tmp_path / "dog.safetensors", tmp_path / "other.safetensors"
    dog_model.save(path)
    with pytest.raises(ReadError, match="there is none"):
        store.load_prepared(tmp_path / "none.safetensors")
    with pytest.raises(ReadError, match="from another"):
        store.load_prepared(path, model=trimesh.creation.box())
    save_file({"a": np.zeros(3)}, other)
    with pytest.raises(ReadError, match="another kind"):
        store.load_prepared(other)
    other.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(ReadError, match="cannot read it"):
        store.load_prepared(other)
    damaged = bytearray(path.read_bytes())
    damaged[-5] ^= 0x40  # one bit of its numbers
    other.write_bytes(damaged)
    with pytest.raises(ReadError, match="aren't those that were written"):
        store.load_prepared(other)
    save_file(load_file(path), other, metadata={"kind": store._KIND, "version": "0"})
    with pytest.raises(ReadError, match="version 0"):
        store.load_prepared(other)
    monkeypatch.setattr(store, "_descriptor_hash", lambda: "other")
    with pytest.raises(ReadError, match="descriptors"):
        store.load_prepared(path)
    with pytest.raises(WriteError, match="safetensors"):
        dog_model.save(tmp_path / "dog.npz")


def test_a_rod_between_few_pixels_is_seen() -> None:
    rod = prepare(trimesh.creation.cylinder(0.01, 2.0), config=SMALL)
    assert len(rod.directions) == SMALL.views


@pytest.mark.parametrize(
    ("thing", "message"),
    [
        (np.random.default_rng(0).random((500, 3)) * (1, 1, 0), "one plane"),
        (trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), "one plane"),
        (np.eye(3), "one plane"),
        (np.zeros((0, 3)), "empty"),
        (np.random.default_rng(0).random((8, 3)), "seen from all around"),
    ],
)
def test_models_that_have_no_outside_are_refused(thing: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        prepare(thing)


def test_missing_returns_in_files_are_dropped_and_counted(tmp_path: Path) -> None:
    cloud, _ = trimesh.sample.sample_surface(model(), 3000, seed=0)
    path = tmp_path / "model.npy"
    np.save(path, np.vstack([np.asarray(cloud), np.full((7, 3), np.nan)]))
    prepared = prepare(path, config=SMALL)
    assert any("dropped 7" in note for note in prepared.notes)
