"""All views of a scan on one page: shaded depth images in a grid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from fullturn.errors import InputError
from fullturn.viz.canvas import new_figure
from fullturn.viz.figures import MUTED, write_figure

if TYPE_CHECKING:
    from os import PathLike

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

NEAR, FAR = (0.957, 0.831, 0.545), (0.184, 0.451, 0.784)  # told apart with any color vision
SHEET_PIXELS, LEAST_TILE = 1800, 48
_LABEL, _GAP, _DPI = 16, 6, 100  # pixels


def save_contact_sheet(
    path: str | PathLike[str],
    depths: Sequence[NDArray[np.float64]],
    *,
    focals: Sequence[float],
    labels: Sequence[str],
) -> None:
    """Write the picture of `draw_contact_sheet`; the suffix chooses PNG, PDF, SVG or JPEG.

    Raises:
        DependencyError: matplotlib is missing.
        InputError: no images, or not one focal length and one label an image.
        WriteError: another suffix, or the place cannot be written; what was there before is kept.
    """
    write_figure(path, lambda: draw_contact_sheet(depths, focals=focals, labels=labels), dpi=_DPI)


def draw_contact_sheet(
    depths: Sequence[NDArray[np.float64]],
    *,
    focals: Sequence[float],
    labels: Sequence[str],
) -> Figure:
    """Return a grid of depth images (h, w), inf where nothing was seen, each above its label.

    Near is yellow, far is blue, and surfaces get darker as they turn away from the camera, whose
    focal length in pixels is needed for that.
    """
    if len(depths) == 0 or not len(depths) == len(focals) == len(labels):
        raise InputError(
            "expected at least one depth image, and one focal length and one label for each, got "
            f"{len(depths)}, {len(focals)} and {len(labels)}"
        )
    columns = math.ceil(math.sqrt(1.4 * len(depths)))
    rows = math.ceil(len(depths) / columns)
    side = max(LEAST_TILE, min(max(max(d.shape) for d in depths), SHEET_PIXELS // columns))
    down, right = side + _LABEL, side + _GAP
    width, height = columns * right, rows * down
    sheet = np.full((height, width, 3), 255, dtype=np.uint8)
    corners = [(down * (k // columns), right * (k % columns)) for k in range(len(depths))]
    for depth, focal, (top, left) in zip(depths, focals, corners, strict=True):
        tile = _fitted(shade(depth, focal), side)
        sheet[top : top + len(tile), left : left + tile.shape[1]] = tile

    figure = new_figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(sheet, interpolation="nearest", aspect="auto", extent=(0, width, height, 0))
    axes.set_axis_off()
    for label, (top, left) in zip(labels, corners, strict=True):
        axes.text(
            left + side / 2,
            top + side + _LABEL / 2,
            label,
            ha="center",
            va="center",
            color=MUTED,
            fontsize=min(8.0, side / 14),
        )
    return figure


def shade(depth: NDArray[np.float64], focal: float) -> NDArray[np.uint8]:
    """Colors (h, w, 3) of a depth image lit from the camera; white where nothing was seen.

    The light is the cosine between the surface's normal and the line of sight, with the slope of
    the depth taken over both neighbors, or over one at a rim.
    """
    seen = np.isfinite(depth)
    colors = np.ones((*depth.shape, 3))
    if seen.any():
        near, far = depth[seen].min(), depth[seen].max()
        share = (depth[seen] - near) / ((far - near) or 1.0)
        slope_sq = _slope(depth, 0) ** 2 + _slope(depth, 1) ** 2
        # Per pixel, so that it has to be counted in the pixel's size at that depth.
        light = 1.0 / np.sqrt(1.0 + slope_sq[seen] * (focal / depth[seen]) ** 2)
        color = (1.0 - share[:, None]) * np.array(NEAR) + share[:, None] * np.array(FAR)
        colors[seen] = color * (0.25 + 0.75 * light[:, None])
    return np.round(255.0 * colors).astype(np.uint8)


def _slope(depth: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Change of depth per pixel along an axis; the smaller one where the two sides differ."""
    known = np.where(np.isfinite(depth), depth, np.nan)
    edge = np.full_like(np.take(known, [0], axis=axis), np.nan)
    step = np.abs(np.diff(known, axis=axis))
    before = np.concatenate([edge, step], axis=axis)
    after = np.concatenate([step, edge], axis=axis)
    return np.nan_to_num(np.fmin(before, after))


def _fitted(picture: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
    """The picture, its longer side at most `side`: by leaving out pixels."""
    height, width = picture.shape[:2]
    scale = min(1.0, side / max(height, width))
    rows = (np.arange(max(1, int(height * scale))) / scale).astype(np.int64)
    columns = (np.arange(max(1, int(width * scale))) / scale).astype(np.int64)
    return picture[rows][:, columns]
