"""Candidate matches agree with a search by hand, pair by pair."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fullturn.matching.correspondence import Matches, candidate_matches


def descriptors(count: int, *, seed: int, channels: int = 12) -> Tensor:
    rows = torch.from_numpy(np.random.default_rng(seed).uniform(size=(count, channels)))
    return rows / rows.norm(dim=1, keepdim=True)


def pairs(matches: Matches) -> list[tuple[int, int]]:
    return list(zip(matches.source.tolist(), matches.target.tolist(), strict=True))


def by_hand(source: np.ndarray, target: np.ndarray) -> dict[tuple[int, int], float]:
    similarity = source @ target.T
    forward = {(i, int(row.argmax())) for i, row in enumerate(similarity)}
    backward = {(int(column.argmax()), j) for j, column in enumerate(similarity.T)}
    return {(i, j): similarity[i, j] for i, j in forward | backward}


@pytest.mark.parametrize(("n", "m"), [(40, 30), (30, 40), (4, 4), (1, 7), (7, 1)])
def test_agrees_with_a_search_by_hand(n: int, m: int) -> None:
    source, target = descriptors(n, seed=1), descriptors(m, seed=2)
    matches = candidate_matches(source @ target.T)
    expected = by_hand(source.numpy(), target.numpy())
    found = dict(zip(pairs(matches), matches.similarity.tolist(), strict=True))
    assert found.keys() == expected.keys()
    for pair, similarity in found.items():
        assert similarity == pytest.approx(expected[pair], abs=1e-7)


def test_the_best_come_first_and_the_limit_keeps_them() -> None:
    source, target = descriptors(60, seed=3), descriptors(50, seed=4)
    everything = candidate_matches(source @ target.T)
    assert bool((everything.similarity.diff() <= 0).all())
    assert len(set(pairs(everything))) == len(everything.source)
    few = candidate_matches(source @ target.T, limit=17)
    assert pairs(few) == pairs(everything)[:17]
    torch.testing.assert_close(few.similarity, everything.similarity[:17])


def test_equal_descriptors_are_matched_first() -> None:
    rows = descriptors(50, seed=5)
    order = torch.from_numpy(np.random.default_rng(6).permutation(50))
    matches = candidate_matches(rows @ rows[order].T)
    first = pairs(matches)[:50]
    assert sorted(i for i, _ in first) == list(range(50))
    assert all(int(order[j]) == i for i, j in first)


def test_swapping_the_clouds_transposes_the_pairs() -> None:
    source, target = descriptors(40, seed=7), descriptors(35, seed=8)
    there = candidate_matches(source @ target.T)
    back = candidate_matches(target @ source.T)
    assert set(pairs(there)) == {(i, j) for j, i in pairs(back)}


def test_the_order_of_points_is_nothing() -> None:
    source, target = descriptors(40, seed=9), descriptors(35, seed=10)
    rng = np.random.default_rng(11)
    p, q = (torch.from_numpy(rng.permutation(k)) for k in (40, 35))
    plain = candidate_matches(source @ target.T, limit=30)
    mixed = candidate_matches(source[p] @ target[q].T, limit=30)
    assert pairs(plain) == [(int(p[i]), int(q[j])) for i, j in pairs(mixed)]
