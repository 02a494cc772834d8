"""What the sensor of a scan must have seen, though nobody says where it stood."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry.directions import sphere_directions
from fullturn.pose.visibility import DepthImages

_DIRECTIONS, _LIKELY = 64, 24  # looked from, and of these the ones that hide the fewest points
_AWAY = 8.0  # radii between a scan and its sensor, where that isn't known


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
        if viewpoint is None:
            middle = points.mean(0)
            radius = (points - middle).norm(dim=-1).amax()
            around = torch.from_numpy(sphere_directions(_DIRECTIONS)).to(points)
            eyes = middle + _AWAY * radius * around
            hidden = DepthImages(points, eyes, spacing=spacing).hidden(points)
            eyes = eyes[hidden.argsort(stable=True)[:_LIKELY]]
        else:
            eyes = viewpoint.to(points)[None]
        self._images = DepthImages(points, eyes, spacing=spacing)
        self.hidden = self._images.hidden(points)  # the share of the scan's own, from each place

    def contradicted(self, points: Float[Tensor, "k m 3"]) -> Float[Tensor, "v k"]:
        """The share of each set of points that contradicts each of the places."""
        return self._images.violations(points)[..., :2].sum(-1)
