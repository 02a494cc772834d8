"""What sensors must have seen from where they stood, or may have stood."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from fullturn.pose.depth import NEAREST, nearest_depth, pixel_of, project, sideways, widened

_MAX_PIXELS = 256  # of a side
_WIDEST = 1.0  # tangent of the largest angle off the center of the view: 45°
_HIDDEN = 3.0  # spacings behind a point's pixel that count


@dataclass(frozen=True, eq=False)
class Look:
    """Where points lie in what was seen from each of v places."""

    behind: Float[Tensor, " v *points"]  # depth beyond the surface seen; 0 where none was
    in_front: Bool[Tensor, " v *points"]  # of the surface seen
    in_nothing: Bool[Tensor, " v *points"]  # in front of nothing seen
    outside: Bool[Tensor, " v *points"]  # of the image


class DepthImages:
    """Coarse depth images of a cloud, one from each of v places of a sensor.

    Pixels are 1.5 `spacing` wide at the cloud's distance. A point contradicts what was seen only if
    it lies in front of the nearest depth in its pixel and around it, or where all of them are
    empty. An image is a disk that ends a quarter of its radius beyond the cloud, and at 45°;
    outside, where the sensor may not have looked, points are counted apart.
    """

    def __init__(
        self, points: Float[Tensor, "n 3"], viewpoints: Float[Tensor, "v 3"], *, spacing: float
    ) -> None:
        offset = points.mean(0) - viewpoints
        distance = offset.norm(dim=-1)
        # A sensor in the middle of the cloud looks everywhere; pick a side.
        forward = torch.where(distance[:, None] < 1e-6, points[0] - viewpoints, offset)
        forward = forward / forward.norm(dim=-1, keepdim=True).clamp_min(1e-12)
        right = sideways(forward)
        self._frame = torch.stack([right, torch.linalg.cross(right, forward), forward], -1)
        self.viewpoints = viewpoints
        self._spacing = spacing
        image, depth = project(points, self.viewpoints, self._frame)
        reach = image.norm(dim=-1).masked_fill(depth <= NEAREST, 0.0).amax(-1).double()
        radius = (1.25 * reach).clamp_max(_WIDEST)
        width = torch.maximum(
            1.5 * spacing / distance.double().clamp_min(1e-6), 2 * radius / _MAX_PIXELS
        ).clamp_min(1e-9)
        self._side = int((2 * radius / width).amax()) + 1
        self._radius, self._width = (x.to(points)[:, None] for x in (radius, width))
        cell, inside = self._cell(image, depth)
        nearest = nearest_depth(cell, depth, inside, side=self._side)
        self._nearest, self._around = nearest.flatten(1), -widened(-nearest).flatten(1)

    def look(self, points: Float[Tensor, "*points 3"]) -> Look:
        """What is said of each point from each place."""
        image, depth = project(points.reshape(-1, 3), self.viewpoints, self._frame)
        cell, inside = self._cell(image, depth)
        nearest = self._around.gather(1, cell)
        seen = torch.isfinite(nearest)
        behind = torch.where(inside & seen, depth - nearest, 0.0)
        masks = (behind, behind < -2.0 * self._spacing, inside & ~seen, ~inside)
        return Look(*(mask.view(-1, *points.shape[:-1]) for mask in masks))

    def violations(self, points: Float[Tensor, "k n 3"]) -> Float[Tensor, "v k 3"]:
        """Shares of points in front of the surface seen, in front of nothing seen, and outside.

        The first two would have been returned by the sensor in place of what it returned. Those
        outside the image would have been seen if the sensor looked there.
        """
        look = self.look(points)
        masks = (look.in_front, look.in_nothing, look.outside)
        return torch.stack([mask.to(points.dtype).mean(-1) for mask in masks], -1)

    def hidden(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " v"]:
        """The share of points that stand behind what was seen."""
        image, depth = project(points, self.viewpoints, self._frame)
        cell, _ = self._cell(image, depth)
        behind = depth > self._nearest.gather(1, cell) + _HIDDEN * self._spacing
        return behind.to(points.dtype).mean(-1)

    def _cell(self, image: Tensor, depth: Tensor) -> tuple[Int[Tensor, "v n"], Bool[Tensor, "v n"]]:
        inside = (depth > NEAREST) & (image.norm(dim=-1) <= self._radius)
        half, width = self._radius[..., None], self._width[..., None]
        return pixel_of(image, inside, half=half, width=width, side=self._side), inside
