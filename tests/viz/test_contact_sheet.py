"""The contact sheet: where tiles stand, what the shading means, and what it refuses."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from fullturn.errors import DependencyError, InputError, WriteError
from fullturn.viz.contact_sheet import FAR, NEAR, draw_contact_sheet, save_contact_sheet, shade


def slope(angle_deg: float, *, focal: float) -> np.ndarray:
    """Depth of a wall around z = 2 that turns away to the right by an angle."""
    x = (np.arange(41) - 20) / focal
    return np.tile(2.0 / (1.0 - x * np.tan(np.deg2rad(angle_deg))), (30, 1))


@pytest.mark.parametrize("angle_deg", [0.0, 45.0, 70.0])
def test_walls_get_darker_as_they_turn_away(angle_deg):
    depth = slope(angle_deg, focal=2000.0)
    middle = shade(depth, 2000.0)[15, 20].astype(float)
    light = 0.25 + 0.75 * np.cos(np.deg2rad(angle_deg))
    share = (2.0 - depth.min()) / ((depth.max() - depth.min()) or 1.0)
    color = (1 - share) * np.array(NEAR) + share * np.array(FAR)
    np.testing.assert_allclose(middle, 255 * light * color, atol=4)


def test_a_jump_in_depth_is_no_slope_and_nothing_is_white():
    depth = np.full((10, 12), 1.0)
    depth[:, 6:] = 3.0
    depth[:2] = np.inf
    colors = shade(depth, 100.0)
    assert (colors[:2] == 255).all()
    np.testing.assert_array_equal(colors[2:, :6], np.broadcast_to(colors[2, 0], (8, 6, 3)))
    np.testing.assert_allclose(colors[5, 0], 255 * np.array(NEAR), atol=1)
    np.testing.assert_allclose(colors[5, -1], 255 * np.array(FAR), atol=1)
    assert (shade(np.full((3, 4), np.inf), 100.0) == 255).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (40, 60), (200, 150)])
@pytest.mark.parametrize("count", [1, 5, 120])
def test_every_view_has_its_tile(shape, count, tmp_path):
    pytest.importorskip("matplotlib")
    figure = draw_contact_sheet(
        [np.full(shape, 1.0)] * count, focals=[90.0] * count, labels=[f"v{k}" for k in range(count)]
    )
    assert [text.get_text() for text in figure.axes[0].texts] == [f"v{k}" for k in range(count)]
    assert max(figure.get_size_inches()) * figure.dpi < 2200
    sheet = figure.axes[0].images[0].get_array()
    assert (sheet != 255).any(axis=2).sum() >= count


def test_the_same_views_give_the_same_bytes(tmp_path):
    pytest.importorskip("matplotlib")
    for name in ("a.png", "b.png"):
        save_contact_sheet(
            tmp_path / name, [slope(30.0, focal=99.0)], focals=[99.0], labels=["one"]
        )
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_what_cannot_be_drawn_is_named(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="at least one depth image"):
        draw_contact_sheet([], focals=[], labels=[])
    with pytest.raises(InputError, match="got 1, 2 and 1"):
        draw_contact_sheet([np.ones((2, 2))], focals=[1.0, 1.0], labels=["a"])
    with pytest.raises(WriteError, match=r"\.png"):
        save_contact_sheet(tmp_path / "a.bmp", [np.ones((2, 2))], focals=[1.0], labels=["a"])
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    with pytest.raises(DependencyError, match=r"fullturn\[viz\]"):
        draw_contact_sheet([np.ones((2, 2))], focals=[1.0], labels=["a"])
