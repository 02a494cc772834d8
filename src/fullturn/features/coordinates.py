"""The plainest descriptors: coordinates of the neighbors, absolute and relative.

Not invariant to rotation, but robust to noise, since nothing is divided by a small number.
"""

from __future__ import annotations

from jaxtyping import Float, Int
from torch import Tensor

from fullturn.geometry.neighbors import fill_with_self, gather


def xyz(
    points: Float[Tensor, "*batch n 3"], neighbor_index: Int[Tensor, "*batch n k"]
) -> Float[Tensor, "*batch n k 3"]:
    """Coordinates p_j of each neighbor; a missing neighbor (−1) counts as the point itself.

    Meant for clouds that are centered on their own mean.
    """
    return gather(points, fill_with_self(neighbor_index))


def delta_xyz(
    points: Float[Tensor, "*batch n 3"], neighbor_index: Int[Tensor, "*batch n k"]
) -> Float[Tensor, "*batch n k 3"]:
    """Offset p_j − p_i of each neighbor; 0 for a missing neighbor (−1)."""
    return xyz(points, neighbor_index) - points[..., None, :]
