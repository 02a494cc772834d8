"""Clouds of different sizes as one batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from fullturn.errors import InputError


@dataclass(frozen=True, eq=False)
class CloudBatch:
    """Clouds padded to one length; each cloud's padding is copies of its first point.

    >>> batch = CloudBatch.collate([torch.zeros(2, 3), torch.ones(3, 3)])
    >>> batch.points.shape, batch.mask.sum(1)
    (torch.Size([2, 3, 3]), tensor([2, 3]))
    """

    points: Float[Tensor, "b n 3"]  # as posed, not centered
    mask: Bool[Tensor, "b n"]  # True: a point of the cloud
    normals: Float[Tensor, "b n 3"] | None = None  # None: the network estimates them

    def to(self, device_or_dtype: torch.device | torch.dtype | str) -> CloudBatch:
        """The same clouds on another device or with another dtype (of points and normals)."""
        points = self.points.to(device_or_dtype)
        normals = None if self.normals is None else self.normals.to(device_or_dtype)
        return CloudBatch(points, self.mask.to(points.device), normals)

    @staticmethod
    def collate(clouds: Sequence[Float[Tensor, "_ 3"]]) -> CloudBatch:
        """One batch of these clouds, in their order.

        Raises InputError where there is no cloud, or a cloud without points.
        """
        if not clouds or any(len(cloud) == 0 for cloud in clouds):
            raise InputError(
                "a batch needs at least one cloud and each cloud at least one point, got sizes "
                f"{[len(cloud) for cloud in clouds]}"
            )
        sizes = torch.tensor([len(cloud) for cloud in clouds])
        longest = int(sizes.max())
        points = torch.stack(
            [torch.cat([cloud, cloud[:1].expand(longest - len(cloud), 3)]) for cloud in clouds]
        )
        mask = torch.arange(longest) < sizes[:, None]
        return CloudBatch(points, mask.to(points.device))

    @staticmethod
    def join(batches: Sequence[CloudBatch]) -> CloudBatch:
        """The clouds of several batches as one; normals are kept where all have them."""
        longest = max(batch.points.shape[1] for batch in batches)
        normals = [batch.normals for batch in batches if batch.normals is not None]
        return CloudBatch(
            torch.cat([_lengthen(batch.points, longest) for batch in batches]),
            torch.cat(
                [
                    torch.nn.functional.pad(batch.mask, (0, longest - batch.mask.shape[1]))
                    for batch in batches
                ]
            ),
            torch.cat([_lengthen(some, longest) for some in normals])
            if len(normals) == len(batches)
            else None,
        )


def _lengthen(rows: Float[Tensor, "b n c"], longest: int) -> Float[Tensor, "b m c"]:
    first = rows[:, :1].expand(-1, longest - rows.shape[1], -1)
    return torch.cat([rows, first], dim=1)
