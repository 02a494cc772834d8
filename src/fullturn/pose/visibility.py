"""What a sensor at a known place must have seen."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


class DepthImage:
    """A coarse depth image of a cloud from where its sensor stood.

    Pixels are `spacing` wide at the cloud's distance, and each holds the largest depth of the
    points in it and around it, so that only a clear contradiction counts as one.
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
        self._pixel = max(1.5 * spacing / float(distance), 1.0 / 256)
        self._low = image.amin(0) - 2 * self._pixel
        width, height = ((image.amax(0) - self._low) / self._pixel).ceil().long().add(3).tolist()
        self._size = (min(width, 512), min(height, 512))
        farthest = torch.full(self._size, -1.0, dtype=points.dtype, device=points.device).view(-1)
        cell, inside = self._cell(image)
        farthest.scatter_reduce_(0, cell[inside], depth[inside], "amax")
        grown = torch.nn.functional.max_pool2d(farthest.view(1, 1, *self._size), 3, 1, 1)
        self._farthest = grown.view(-1)

    def violations(self, points: Float[Tensor, "k n 3"]) -> Float[Tensor, "k 2"]:
        """Shares of points that float in front of the surface seen, and in front of nothing seen.

        Both would have been returned by the sensor in place of what it returned.
        """
        image, depth = self._project(points)
        cell, inside = self._cell(image)
        farthest = torch.where(inside, self._farthest[cell], -1.0)
        visible = depth > 1e-3
        seen = farthest > 0
        in_front = visible & seen & (depth < farthest - self._margin)
        # An empty pixel counts only if it lies well inside or outside the silhouette: grown above.
        in_nothing = visible & ~seen
        shares = [mask.to(points.dtype).mean(-1) for mask in (in_front, in_nothing)]
        return torch.stack(shares, -1)

    def _project(self, points: Tensor) -> tuple[Tensor, Tensor]:
        local = (points - self._viewpoint) @ self._frame
        depth = local[..., 2]
        return local[..., :2] / depth.clamp_min(1e-3).unsqueeze(-1), depth

    def _cell(self, image: Tensor) -> tuple[Tensor, Tensor]:
        position = (image - self._low) / self._pixel
        x, y = position.clamp(-1, 1e6).floor().long().unbind(-1)
        width, height = self._size
        inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
        return (x * height + y).masked_fill(~inside, 0), inside
