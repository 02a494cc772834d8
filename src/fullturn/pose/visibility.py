"""What a sensor at a known place must have seen."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

_MAX_PIXELS = 256  # of a side


class DepthImage:
    """A coarse depth image of a cloud from where its sensor stood.

    Pixels are 1.5 `spacing` wide at the cloud's distance, and each holds the largest depth of the
    points in it and around it, so that only a clear contradiction counts as one. The image ends a
    quarter of its size beyond the cloud, and at 45° from its center: nothing is known outside.
    """

    def __init__(
        self, points: Float[Tensor, "n 3"], viewpoint: Float[Tensor, "3"], *, spacing: float
    ) -> None:
        forward = points.mean(0) - viewpoint
        distance = forward.norm().clamp_min(1e-6)
        forward = forward / distance
        helper = torch.eye(3, dtype=points.dtype, device=points.device)[forward.abs().argmin()]
        right = torch.linalg.cross(forward, helper)
        right = right / right.norm()
        self._frame = torch.stack([right, torch.linalg.cross(right, forward), forward], -1)
        self._viewpoint = viewpoint
        self._margin = 2.0 * spacing
        image, depth = self._project(points)
        low, high = image.clamp(-1, 1).amin(0), image.clamp(-1, 1).amax(0)
        margin = 0.25 * (high - low)
        self._low, high = (low - margin).clamp_min(-1), (high + margin).clamp_max(1)
        extent = (high - self._low).clamp_min(1e-6)
        self._pixel = max(1.5 * spacing / float(distance), float(extent.max()) / _MAX_PIXELS)
        width, height = (extent / self._pixel).ceil().long().tolist()
        self._size = (max(width, 1), max(height, 1))
        farthest = torch.full(self._size, -1.0, dtype=points.dtype, device=points.device).view(-1)
        cell, inside = self._cell(image, depth)
        farthest.scatter_reduce_(0, cell[inside], depth[inside], "amax")
        grown = torch.nn.functional.max_pool2d(farthest.view(1, 1, *self._size), 3, 1, 1)
        self._farthest = grown.view(-1)

    def violations(self, points: Float[Tensor, "k n 3"]) -> Float[Tensor, "k 2"]:
        """Shares of points that float in front of the surface seen, and in front of nothing seen.

        Both would have been returned by the sensor in place of what it returned. A pixel is empty
        only if its neighbors are, too; points outside the image count as neither.
        """
        image, depth = self._project(points)
        cell, inside = self._cell(image, depth)
        farthest = self._farthest[cell]
        in_front = inside & (farthest > 0) & (depth < farthest - self._margin)
        in_nothing = inside & (farthest <= 0)
        shares = [mask.to(points.dtype).mean(-1) for mask in (in_front, in_nothing)]
        return torch.stack(shares, -1)

    def _project(self, points: Tensor) -> tuple[Tensor, Tensor]:
        local = (points - self._viewpoint) @ self._frame
        depth = local[..., 2]
        return local[..., :2] / depth.clamp_min(1e-3).unsqueeze(-1), depth

    def _cell(self, image: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
        position = (image - self._low) / self._pixel
        x, y = position.clamp(-1, 2 * _MAX_PIXELS).floor().long().unbind(-1)
        width, height = self._size
        inside = (depth > 1e-3) & (x >= 0) & (y >= 0) & (x < width) & (y < height)
        return (x * height + y).masked_fill(~inside, 0), inside
