"""The scaled Sinkhorn equals the same rounds in the log domain, gradients included."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fullturn.errors import InputError
from fullturn.matching.sinkhorn import sinkhorn


def scores_of(*shape: int, spread: float = 1.0, seed: int = 0, shift: float = 0.0) -> Tensor:
    return torch.from_numpy(np.random.default_rng(seed).normal(shift, spread, size=shape))


def log_domain(scores: Tensor, *, rounds: int) -> Tensor:
    """The definition: pad with slack 0, subtract log-sums of real rows, then of real columns."""
    b, n, m = scores.shape
    padded = scores.new_zeros(b, n + 1, m + 1)
    padded[:, :n, :m] = scores
    for _ in range(rounds):
        real = padded[:, :n] - padded[:, :n].logsumexp(-1, keepdim=True)
        padded = torch.cat([real, padded[:, n:]], 1)
        real = padded[..., :m] - padded[..., :m].logsumexp(-2, keepdim=True)
        padded = torch.cat([real, padded[..., m:]], 2)
    return padded[:, :n, :m].exp()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("spread", [0.0, 1.0, 10.0, 40.0])
@pytest.mark.parametrize("rounds", [1, 2, 5, 6, 12])
def test_equals_the_log_domain(spread: float, rounds: int, dtype: torch.dtype) -> None:
    scores = scores_of(2, 60, 45, spread=spread)
    matching = sinkhorn(scores.to(dtype), rounds=rounds)
    assert matching.dtype == dtype
    tolerance = 1e-6 if dtype == torch.float32 else 1e-13
    expected = log_domain(scores.to(dtype).double(), rounds=rounds)
    torch.testing.assert_close(matching.double(), expected, atol=tolerance, rtol=0)


@pytest.mark.parametrize("shift", [-1e4, -100.0, -88.0, 88.0, 100.0, 1e4])
@pytest.mark.parametrize("rounds", [5, 11])
def test_scores_beyond_the_range_of_the_exponential(shift: float, rounds: int) -> None:
    scores = scores_of(2, 30, 40, spread=3.0, shift=shift).float().requires_grad_()
    matching = sinkhorn(scores, rounds=rounds)
    expected = log_domain(scores.detach().double(), rounds=rounds)
    torch.testing.assert_close(matching.double(), expected, atol=2e-6, rtol=0)
    (matching * scores_of(2, 30, 40, seed=1).float()).sum().backward()
    assert scores.grad is not None
    assert bool(torch.isfinite(scores.grad).all())


@pytest.mark.parametrize("rounds", [5, 30])
def test_a_crowd_that_wants_one_partner(rounds: int) -> None:
    """Each round makes the scale of that column smaller by as much as there are rows."""
    scores = torch.full((1, 2000, 3), -1000.0)
    scores[..., 0] = 1000.0
    matching = sinkhorn(scores.requires_grad_(), rounds=rounds)
    expected = log_domain(scores.detach().double(), rounds=rounds)
    torch.testing.assert_close(matching.double(), expected, atol=1e-6, rtol=1e-4)
    matching.square().sum().backward()
    assert scores.grad is not None
    assert bool(torch.isfinite(scores.grad).all())


def test_columns_sum_to_at_most_one_and_rows_nearly_so() -> None:
    scores = scores_of(3, 20, 30, spread=4.0)
    matching = sinkhorn(scores, rounds=2000)
    assert bool((matching >= 0).all())
    assert bool((matching.sum(-2) <= 1.0 + 1e-12).all())
    assert bool((matching.sum(-1) <= 1.0 + 1e-4).all())
    # So many rounds lead to one answer, whichever side comes first.
    back = sinkhorn(scores.mT, rounds=2000)
    torch.testing.assert_close(back.mT, matching, atol=1e-4, rtol=0)


def test_slack_takes_points_without_a_partner() -> None:
    scores = torch.full((1, 4, 4), -20.0)
    scores[0, range(3), [2, 0, 1]] = 20.0
    matching = sinkhorn(scores, rounds=5)[0]
    torch.testing.assert_close(matching.argmax(-1)[:3], torch.tensor([2, 0, 1]))
    # The slack row isn't normalized, so it keeps 1 / (rounds + 1) of each column.
    torch.testing.assert_close(matching[:3].sum(-1), torch.full((3,), 5 / 6), atol=1e-5, rtol=0)
    assert float(matching[3].sum()) < 1e-6
    assert float(matching[:, 3].sum()) < 1e-6


def test_permuting_points_permutes_the_matching() -> None:
    scores = scores_of(1, 12, 15)
    rng = np.random.default_rng(3)
    p, q = (torch.from_numpy(rng.permutation(k)) for k in (12, 15))
    torch.testing.assert_close(sinkhorn(scores[:, p][..., q]), sinkhorn(scores)[:, p][..., q])


@pytest.mark.parametrize("fill", [0.0, 500.0, -500.0])
def test_padding_changes_nothing(fill: float) -> None:
    sizes = [(9, 14), (12, 10), (12, 14), (1, 1)]
    batch = torch.full((4, 12, 14), fill, dtype=torch.float64)
    source_mask = torch.zeros(4, 12, dtype=torch.bool)
    target_mask = torch.zeros(4, 14, dtype=torch.bool)
    for i, (n, m) in enumerate(sizes):
        batch[i, :n, :m] = scores_of(n, m, seed=i, spread=3.0)
        source_mask[i, :n] = True
        target_mask[i, :m] = True
    batch.requires_grad_()
    matching = sinkhorn(batch, source_mask, target_mask)
    matching.square().sum().backward()
    assert batch.grad is not None
    for i, (n, m) in enumerate(sizes):
        alone = batch.detach()[i : i + 1, :n, :m].clone().requires_grad_()
        expected = sinkhorn(alone)
        torch.testing.assert_close(matching[i : i + 1, :n, :m], expected)
        torch.testing.assert_close(matching[i].sum(), expected.sum())
        expected.square().sum().backward()
        assert alone.grad is not None
        torch.testing.assert_close(batch.grad[i : i + 1, :n, :m], alone.grad)
        torch.testing.assert_close(batch.grad[i].abs().sum(), alone.grad.abs().sum())


@pytest.mark.parametrize("rounds", [1, 3, 5, 7, 11])
def test_gradcheck(rounds: int) -> None:
    for spread in (0.5, 5.0):
        scores = scores_of(2, 4, 3, spread=spread).requires_grad_()
        assert torch.autograd.gradcheck(lambda x: sinkhorn(x, rounds=rounds), (scores,))


@pytest.mark.parametrize("rounds", [5, 8])
@pytest.mark.parametrize("spread", [1.0, 30.0])
def test_gradients_equal_those_of_the_log_domain(rounds: int, spread: float) -> None:
    weights = scores_of(2, 40, 30, seed=5)
    gradients = []
    for function in (sinkhorn, log_domain):
        scores = scores_of(2, 40, 30, spread=spread).requires_grad_()
        (function(scores, rounds=rounds) * weights).sum().backward()
        assert scores.grad is not None
        gradients.append(scores.grad)
    torch.testing.assert_close(gradients[0], gradients[1], atol=1e-12, rtol=1e-9)


def test_the_scores_are_left_alone() -> None:
    scores = scores_of(1, 5, 6)
    before = scores.clone()
    sinkhorn(scores)
    torch.testing.assert_close(scores, before, atol=0, rtol=0)


def test_rounds_are_counted_from_one() -> None:
    with pytest.raises(InputError, match="rounds must be at least 1, got 0"):
        sinkhorn(scores_of(1, 2, 2), rounds=0)


def test_a_batch_at_once_equals_its_items_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a CPU the items take turns; on other devices the whole batch is one portion."""
    found = []
    for _ in range(2):
        scores = scores_of(3, 9, 7, spread=3.0).requires_grad_()
        matching = sinkhorn(scores, rounds=7)
        matching.square().sum().backward()
        with torch.no_grad():
            torch.testing.assert_close(sinkhorn(scores, rounds=7), matching)
        found.append((matching.detach(), scores.grad))
        monkeypatch.setattr("fullturn.matching.sinkhorn._portions", lambda matrix: [slice(None)])
    torch.testing.assert_close(*found)
