"""What the sensor of a scan must have seen, though nobody says where it stood."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry.directions import sphere_directions
from fullturn.pose.visibility import DepthImages

_DIRECTIONS = 64  # looked from, where nobody says where the sensor stood
_AWAY = 8.0  # radii between a scan and its sensor, where that isn't known


class Sights:
    """Depth images of one scan from all places where its sensor may have stood.

    Where the `viewpoint` is known, it alone is; else 64 directions. A sensor sees no point behind
    another, so that of the scan's own points few are `hidden` from the true one. A point of another
    scan contradicts a place if it stands in front of what was seen from there, or where nothing was
    seen.
    """

    def __init__(
        self,
        points: Float[Tensor, "n 3"],
        *,
        spacing: float,
        viewpoint: Float[Tensor, "3"] | None = None,
    ) -> None:
        if viewpoint is None:
            middle = points.mean(0)
            radius = (points - middle).norm(dim=-1).amax()
            around = torch.from_numpy(sphere_directions(_DIRECTIONS)).to(points)
            eyes = middle + _AWAY * radius * around
        else:
            eyes = viewpoint.to(points)[None]
        self._images = DepthImages(points, eyes, spacing=spacing)
        self.hidden = self._images.hidden(points)  # the share of the scan's own, from each place

    def contradicted(self, points: Float[Tensor, "k m 3"]) -> Float[Tensor, "v k"]:
        """The share of each set of points that contradicts each of the places."""
        return self._images.violations(points)[..., :2].sum(-1)
