"""What the sensor of a scan must have seen, though nobody says where it stood."""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

_DIRECTIONS, _LIKELY = 64, 24  # looked from, and of these the ones that hide the fewest points
_AWAY = 8.0  # radii between a scan and its sensor, where that isn't known
_PIXEL, _MARGIN, _HIDDEN = 1.5, 2.0, 3.0  # in spacings: width, and depths that count
_MOST_PIXELS = 256  # of a side
_NEAREST = 1e-3  # least depth
_BEYOND = 1.25  # of the scan's own image: farther out, its sensor may not have looked


class Sights:
    """Depth images of one scan from all places where its sensor may have stood.

    A sensor sees no point behind another. Of 64 directions, those from which the scan's own points
    hide one another least may be the true one; where the `viewpoint` is known, it alone is. A point
    of another scan contradicts a place if it stands in front of what was seen from there, or where
    nothing was seen.
    """

    def __init__(
        self,
        points: Float[Tensor, "n 3"],
        *,
        spacing: float,
        viewpoint: Float[Tensor, "3"] | None = None,
    ) -> None:
        middle = points.mean(0)
        if viewpoint is None:
            radius = (points - middle).norm(dim=-1).amax()
            eyes = middle + _AWAY * radius * _directions(_DIRECTIONS).to(points)
        else:
            eyes = viewpoint.to(points)[None]
        self._margin = _MARGIN * spacing
        self._look(points, eyes, spacing)
        self.hidden = self._hidden(points, spacing)
        if len(eyes) > _LIKELY:
            kept = self.hidden.argsort(stable=True)[:_LIKELY]
            self._look(points, eyes[kept], spacing)
            self.hidden = self.hidden[kept]

    def contradicted(self, points: Float[Tensor, "k m 3"]) -> Float[Tensor, "v k"]:
        """The share of each set of points that contradicts each of the places."""
        image, depth = self._project(points.reshape(-1, 3))
        pixel, inside = self._pixel(image, depth)
        nearest = self._grown.gather(1, pixel)
        # Where nothing was seen, the nearest is infinitely far: all stands in front of it.
        wrong = inside & (depth < nearest - self._margin)
        return wrong.to(points.dtype).view(len(wrong), *points.shape[:2]).mean(-1)

    def _look(self, points: Tensor, eyes: Float[Tensor, "v 3"], spacing: float) -> None:
        forward = points.mean(0) - eyes
        distance = forward.norm(dim=-1).clamp_min(1e-6)
        forward = forward / distance[:, None]
        helper = torch.eye(3, dtype=points.dtype, device=points.device)[forward.abs().argmin(-1)]
        right = torch.nn.functional.normalize(torch.linalg.cross(forward, helper), dim=-1)
        self._R = torch.stack([right, torch.linalg.cross(right, forward), forward], 1)
        self._eyes = eyes
        image, depth = self._project(points)
        self._radius = _BEYOND * image.norm(dim=-1).amax(1, keepdim=True)
        widths = torch.stack([_PIXEL * spacing / distance, 2 * self._radius[:, 0] / _MOST_PIXELS])
        self._width = widths.amax(0)[:, None].clamp_min(1e-9)
        self._side = int((2 * self._radius / self._width).amax()) + 1
        pixel, inside = self._pixel(image, depth)
        nearest = depth.new_full((len(eyes), self._side**2), math.inf)
        nearest.scatter_reduce_(1, pixel, depth.masked_fill(~inside, math.inf), "amin")
        self._nearest = nearest
        square = nearest.view(-1, 1, self._side, self._side)
        self._grown = -torch.nn.functional.max_pool2d(-square, 3, 1, 1).flatten(1)

    def _hidden(self, points: Tensor, spacing: float) -> Float[Tensor, " v"]:
        """The share of the scan's own points that stand behind others."""
        image, depth = self._project(points)
        pixel, _ = self._pixel(image, depth)
        behind = depth > self._nearest.gather(1, pixel) + _HIDDEN * spacing
        return behind.to(points.dtype).mean(-1)

    def _project(self, points: Tensor) -> tuple[Float[Tensor, "v n 2"], Float[Tensor, "v n"]]:
        local = points @ self._R.mT - (self._R @ self._eyes[..., None]).mT
        depth = local[..., 2]
        return local[..., :2] / depth.clamp_min(_NEAREST)[..., None], depth

    def _pixel(
        self, image: Float[Tensor, "v n 2"], depth: Float[Tensor, "v n"]
    ) -> tuple[Int[Tensor, "v n"], Bool[Tensor, "v n"]]:
        inside = (depth > _NEAREST) & (image.norm(dim=-1) <= self._radius)
        place = (image + self._radius[..., None]) / self._width[..., None]
        x, y = place.clamp(0, self._side - 1).long().unbind(-1)
        return (x * self._side + y).masked_fill(~inside, 0), inside


def _directions(count: int) -> Float[Tensor, "v 3"]:
    """Unit vectors, evenly over the sphere, on a spiral."""
    step = np.arange(count) + 0.5
    z, turn = 1 - 2 * step / count, math.pi * (1 + math.sqrt(5)) * step
    level = np.sqrt(1 - z**2)
    return torch.from_numpy(np.stack([level * np.cos(turn), level * np.sin(turn), z], 1))
