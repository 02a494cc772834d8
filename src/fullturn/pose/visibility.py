"""What a sensor at a known place must have seen."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

_MAX_PIXELS = 256  # of a side
_NEAREST = 1e-3  # least depth, normalized
_WIDEST = 1.0  # tangent of the largest angle off the center of the view: 45°


@dataclass(frozen=True, eq=False)
class Look:
    """Where points lie in what a sensor saw."""

    behind: Float[Tensor, "k n"]  # depth beyond the surface seen; 0 where none was
    in_front: Bool[Tensor, "k n"]  # of the surface seen
    in_nothing: Bool[Tensor, "k n"]  # in front of nothing seen
    outside: Bool[Tensor, "k n"]  # of the image


class DepthImage:
    """A coarse depth image of a cloud from where its sensor stood.

    Pixels are 1.5 `spacing` wide at the cloud's distance. A point contradicts what was seen only if
    it lies in front of the nearest depth in its pixel and around it, or where all of them are
    empty. The image is a disk that ends a quarter of its radius beyond the cloud, and at 45°;
    outside, where the sensor may not have looked, points are counted apart.
    """

    def __init__(
        self, points: Float[Tensor, "n 3"], viewpoint: Float[Tensor, "3"], *, spacing: float
    ) -> None:
        forward = points.mean(0) - viewpoint
        distance = float(forward.norm())
        if distance < 1e-6:  # a sensor in the middle of the cloud looks everywhere; pick a side
            forward, distance = points[0] - viewpoint, 1e-6
        forward = forward / forward.norm().clamp_min(1e-12)
        helper = torch.eye(3, dtype=points.dtype, device=points.device)[forward.abs().argmin()]
        right = torch.linalg.cross(forward, helper)
        right = right / right.norm().clamp_min(1e-12)
        self._frame = torch.stack([right, torch.linalg.cross(right, forward), forward], -1)
        self.viewpoint = viewpoint
        self._margin = 2.0 * spacing
        image, depth = self._project(points)
        front = depth > _NEAREST
        radius = image[front].norm(dim=-1).amax() if bool(front.any()) else image.new_zeros(())
        self._radius = min(1.25 * float(radius), _WIDEST)
        self._pixel = max(1.5 * spacing / distance, 2 * self._radius / _MAX_PIXELS, 1e-9)
        self._side = int(2 * self._radius / self._pixel) + 1
        nearest = depth.new_full((self._side * self._side,), math.inf)
        cell, inside = self._cell(image, depth)
        nearest.scatter_reduce_(0, cell[inside], depth[inside], "amin")
        square = nearest.view(1, 1, self._side, self._side)
        grown = -torch.nn.functional.max_pool2d(-square, 3, 1, 1)
        self._nearest = grown.view(-1)

    def look(self, points: Float[Tensor, "k n 3"]) -> Look:
        """What the sensor says of each point."""
        image, depth = self._project(points)
        cell, inside = self._cell(image, depth)
        nearest = self._nearest[cell]
        seen = torch.isfinite(nearest)
        behind = torch.where(inside & seen, depth - nearest, 0.0)
        return Look(behind, behind < -self._margin, inside & ~seen, ~inside)

    def violations(self, points: Float[Tensor, "k n 3"]) -> Float[Tensor, "k 3"]:
        """Shares of points in front of the surface seen, in front of nothing seen, and outside.

        The first two would have been returned by the sensor in place of what it returned. Those
        outside the image would have been seen if the sensor looked there.
        """
        look = self.look(points)
        masks = (look.in_front, look.in_nothing, look.outside)
        return torch.stack([mask.to(points.dtype).mean(-1) for mask in masks], -1)

    def _project(self, points: Tensor) -> tuple[Tensor, Tensor]:
        local = (points - self.viewpoint) @ self._frame
        depth = local[..., 2]
        return local[..., :2] / depth.clamp_min(_NEAREST).unsqueeze(-1), depth

    def _cell(self, image: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
        inside = (depth > _NEAREST) & (image.norm(dim=-1) <= self._radius)
        position = ((image + self._radius) / self._pixel).clamp(0, self._side - 1)
        x, y = position.long().unbind(-1)
        return (x * self._side + y).masked_fill(~inside, 0), inside
