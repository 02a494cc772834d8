"""What a sensor saw of a scene along each line of sight, and what it would see of a model."""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.pose.depth import NEAREST, nearest_depth, pixel_of, project, sideways, widened

_MOST_PIXELS = 512  # a side
_WIDEST = 3.0  # tangent of the largest angle off the middle
_FACING = 0.05  # least cosine between a normal and the line of sight


class Sight:
    """A coarse depth image of a scene, from where the sensor stood.

    Pixels are `pixel` wide at the distance of the origin, which the image is centered on. A point
    counts as contradicted only where its pixel and the eight around it agree.
    """

    def __init__(
        self,
        points: Float[Tensor, "n 3"],
        viewpoint: Float[Tensor, "3"],
        *,
        pixel: float,
        margin: float,
    ) -> None:
        self._viewpoint, self._margin = viewpoint, margin
        distance = max(float(viewpoint.norm()), 1e-6)
        forward = -viewpoint / distance
        right = sideways(forward)
        self._frame = torch.stack([right, torch.linalg.cross(forward, right), forward], 1)
        image, depth = project(points, self._viewpoint, self._frame)
        front = depth > NEAREST
        wide = float(image[front].abs().amax()) if bool(front.any()) else 0.0
        self._wide = min(wide + 2 * pixel / distance, _WIDEST)
        self._pixel = max(pixel / distance, 2 * self._wide / _MOST_PIXELS)
        self._side = int(2 * self._wide / self._pixel) + 1
        nearest = self._nearest(image[None], depth[None], torch.ones_like(depth[None]).bool())
        self._front = -widened(-nearest)[0].flatten()
        self._back = widened(nearest.masked_fill(~nearest.isfinite(), -math.inf))[0].flatten()

    def contradictions(
        self, points: Float[Tensor, "k n 3"], counted: Bool[Tensor, "k n"]
    ) -> tuple[Bool[Tensor, "k n"], Bool[Tensor, "k n"], Bool[Tensor, "k n"]]:
        """Of the counted points, which the sensor saw past, where it saw nothing, which are hidden.

        Seen past: what was seen lies behind the point. Hidden: what was seen lies before it.
        """
        image, depth = project(points, self._viewpoint, self._frame)
        cell, inside = self._cell(image, depth)
        front, back = self._front[cell], self._back[cell]
        counted = counted & inside
        seen = front.isfinite()
        past = counted & seen & (depth < front - self._margin)
        hidden = counted & seen & (depth > back + self._margin)
        return past, counted & ~seen, hidden

    def visible(
        self,
        T_scene_model: Float[Tensor, "k 4 4"],
        surface: Float[Tensor, "m 3"],
        normals: Float[Tensor, "m 3"],
    ) -> Bool[Tensor, "k m"]:
        """Which of a model's surface this eye would see if nothing else were there."""
        points = rigid.apply(T_scene_model, surface)
        toward = torch.nn.functional.normalize(self._viewpoint - points, dim=-1)
        cosine = ((normals @ T_scene_model[:, :3, :3].mT) * toward).sum(-1)
        facing = cosine > _FACING
        image, depth = project(points, self._viewpoint, self._frame)
        cell, inside = self._cell(image, depth)
        nearest = self._nearest(image, depth, facing).flatten(1).gather(1, cell)
        # Within a pixel, a slanted surface reaches deep.
        slant = self._pixel * depth * (1 - cosine**2).clamp_min(0).sqrt() / cosine.clamp_min(0.1)
        return facing & (~inside | (depth <= nearest + self._margin + slant))

    def _nearest(self, image: Tensor, depth: Tensor, counted: Tensor) -> Tensor:
        cell, inside = self._cell(image, depth)
        return nearest_depth(cell, depth, inside & counted, side=self._side)

    def _cell(self, image: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
        inside = (depth > NEAREST) & (image.abs().amax(-1) <= self._wide)
        return pixel_of(image, inside, half=self._wide, width=self._pixel, side=self._side), inside
