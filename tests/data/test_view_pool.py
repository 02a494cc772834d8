"""Views that are kept for training: the same whatever was asked before, in bounded memory."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from fullturn.data.mvp_rg import MvpRgConfig
from fullturn.data.overlap import scan_overlap
from fullturn.data.random_sensor import random_sensor
from fullturn.data.scanner import Scanner, Seen
from fullturn.data.sensor import Sensor
from fullturn.data.shapes import ProceduralShapes
from fullturn.data.view_pool import ViewPool
from fullturn.errors import InputError

SHAPES = ProceduralShapes(4, seed=3)
POINTS, VIEWS, PLENTY = 80, 6, 1 << 24


def rng(*words: int) -> np.random.Generator:
    return np.random.default_rng(words)


def rules(generator: np.random.Generator, *, min_overlap: float = 0.3) -> MvpRgConfig:
    sensor = random_sensor(generator, distance=3.0)
    return MvpRgConfig(points=POINTS, resolution=32, min_overlap=min_overlap, sensor=sensor)


def pool(*, most_bytes: int = PLENTY, seed: int = 0) -> ViewPool:
    return ViewPool(SHAPES, rules, seed=(seed, 7), most_bytes=most_bytes, views=VIEWS)


def content(views: tuple[Seen, Seen]) -> bytes:
    return b"".join(view.points.tobytes() + view.camera.center.tobytes() for view in views)


def test_two_views_are_the_same_whatever_was_asked_before() -> None:
    asked = [(shape, draw) for draw in range(4) for shape in range(4)]
    there, back = pool(), pool()
    first = {key: content(there.two_views(key[0], rng(*key))) for key in asked}
    second = {key: content(back.two_views(key[0], rng(*key))) for key in reversed(asked)}
    alone = {key: content(pool().two_views(key[0], rng(*key))) for key in asked[:5]}
    assert first == second
    assert alone == {key: first[key] for key in alone}
    assert len(set(first.values())) > 8
    assert content(pool(seed=1).two_views(0, rng(0, 0))) != first[0, 0]


@pytest.mark.parametrize("meshes", [0, 1, 3])
def test_memory_is_bounded_and_changes_nothing(meshes: int) -> None:
    a_mesh = VIEWS * (12 * POINTS + 1024)
    small = pool(most_bytes=meshes * a_mesh + a_mesh // 2)
    for draw in range(3):
        for shape in range(4):
            found = content(small.two_views(shape, rng(shape, draw)))
            assert found == content(pool().two_views(shape, rng(shape, draw)))
    assert small.kept_bytes == meshes * a_mesh


def test_kept_views_are_not_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    looks: list[object] = []
    look = Scanner.look

    def counted(self: Scanner, camera: object, **options: object) -> Seen | None:
        looks.append(camera)
        return look(self, camera, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(Scanner, "look", counted)
    kept, forgotten = pool(), pool(most_bytes=0)
    for draw in range(30):
        kept.two_views(0, rng(draw))
    assert 2 <= len(looks) <= VIEWS
    del looks[:]
    for draw in range(30):
        forgotten.two_views(0, rng(draw))
    assert len(looks) >= 60


def test_views_overlap_and_are_in_single_precision() -> None:
    for shape in range(4):
        for first, second in (pool().two_views(shape, rng(draw)) for draw in range(3)):
            assert scan_overlap(first.points, second.points) >= 0.3
            for seen in (first, second):
                assert seen.points.shape == (POINTS, 3)
                assert np.array_equal(seen.points, seen.points.astype(np.float32))
                assert np.linalg.norm(seen.camera.center) == pytest.approx(3.0)
            assert first.camera is not second.camera


def test_what_is_handed_out_can_be_changed() -> None:
    one = pool()
    expected = content(one.two_views(0, rng(0)))
    one.two_views(0, rng(0))[0].points[:] = 0.0
    assert content(one.two_views(0, rng(0))) == expected


def test_a_mesh_without_two_such_views_is_named() -> None:
    strict = ViewPool(
        SHAPES, partial(rules, min_overlap=1.0), seed=(0,), most_bytes=PLENTY, views=2
    )
    with pytest.raises(InputError, match=r"two out of 2 views of procedural_3_00000"):
        strict.two_views(0, rng(0))
    blind = MvpRgConfig(points=POINTS, resolution=32, sensor=Sensor(quantize=100.0))
    with pytest.raises(InputError, match="found none"):
        ViewPool(SHAPES, lambda _: blind, seed=(0,), most_bytes=PLENTY).two_views(0, rng(0))
