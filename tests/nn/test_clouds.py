"""Batches of clouds of different sizes."""

from __future__ import annotations

import pytest
import torch

from fullturn.errors import InputError
from fullturn.nn.clouds import CloudBatch


def clouds(*sizes: int) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return [torch.randn(n, 3, generator=generator) for n in sizes]


def test_collate_keeps_the_points_and_pads_with_the_first() -> None:
    some = clouds(4, 7, 1)
    batch = CloudBatch.collate(some)
    assert batch.points.shape == (3, 7, 3)
    for cloud, points, mask in zip(some, batch.points, batch.mask, strict=True):
        assert mask.sum() == len(cloud)
        assert mask[: len(cloud)].all()
        assert torch.equal(points[mask], cloud)
        assert (points[~mask] == cloud[0]).all()


def test_join_is_collating_all_at_once() -> None:
    some = clouds(4, 7, 1, 9)
    joined = CloudBatch.join([CloudBatch.collate(some[:3]), CloudBatch.collate(some[3:])])
    expected = CloudBatch.collate(some)
    assert torch.equal(joined.points, expected.points)
    assert torch.equal(joined.mask, expected.mask)
    assert joined.normals is None


def test_join_keeps_normals_that_all_have() -> None:
    short, long = (CloudBatch.collate(clouds(n)) for n in (3, 5))
    short, long = (CloudBatch(one.points, one.mask, one.points) for one in (short, long))
    joined = CloudBatch.join([short, long])
    assert joined.normals is not None
    assert torch.equal(joined.normals, joined.points)
    assert CloudBatch.join([short, CloudBatch.collate(clouds(2))]).normals is None


def test_to_changes_the_numbers_and_not_the_mask() -> None:
    batch = CloudBatch.collate(clouds(3, 2))
    batch = CloudBatch(batch.points, batch.mask, batch.points)
    double = batch.to(torch.float64)
    assert double.points.dtype == torch.float64
    assert double.mask.dtype == torch.bool
    assert double.normals is not None
    assert double.normals.dtype == torch.float64
    elsewhere = batch.to("meta")
    assert elsewhere.points.is_meta
    assert elsewhere.mask.is_meta


@pytest.mark.parametrize("sizes", [(), (0,), (3, 0)])
def test_nothing_to_collate(sizes: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="at least one point"):
        CloudBatch.collate(clouds(*sizes))
