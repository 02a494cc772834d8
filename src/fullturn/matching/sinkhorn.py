"""From scores to a matching in which rows and columns share the mass: Sinkhorn with slack."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from fullturn.errors import InputError

# A round can change a scale by as much as the number of points. So many rounds of a million
# points stay inside the range of float32; then the scales go into the exponents.
_ROUNDS_AT_ONCE = 5


def sinkhorn(
    scores: Float[Tensor, "b n m"],
    source_mask: Bool[Tensor, "b n"] | None = None,
    target_mask: Bool[Tensor, "b m"] | None = None,
    *,
    rounds: int = 5,
) -> Float[Tensor, "b n m"]:
    """The matching m* that `rounds` normalizations of rows, then columns, make of exp(scores).

    One slack row and one slack column of score 0 take part in the sums, but are not normalized
    themselves: a point without a partner gives its mass to them. Afterwards every column sums to
    at most 1, every row nearly so. Rows and columns of padding (mask False) are 0.

    The rounds change the scales of rows and columns only, m* = diag(u) exp(scores − shift) diag(v)
    with the shift of a row its largest score (of slack too). What is below it by more than the
    range of the dtype is 0. A perfect match gets rounds / (rounds + 1), the slack the rest.

    >>> sinkhorn(torch.tensor([[[9.0, 0.0], [0.0, -9.0]]])).round(decimals=2)
    tensor([[[0.8100, 0.0000],
             [0.0900, 0.0000]]])
    """
    if rounds < 1:
        raise InputError(f"rounds must be at least 1, got {rounds}")
    for mask, axis in ((source_mask, -1), (target_mask, -2)):
        # A pass over all pairs is a large part of the whole, so none is made for nothing.
        if mask is not None and not bool(mask.all()):
            scores = scores.masked_fill(~mask.unsqueeze(axis), -torch.inf)
    # The matching doesn't depend on this first scale, so no gradient has to pass through it.
    log_row = -scores.detach().amax(-1).clamp_min(0.0)
    log_column = torch.zeros_like(scores[:, 0])
    for done in range(0, rounds, _ROUNDS_AT_ONCE):
        exponent = scores + log_row.unsqueeze(-1)
        if done:
            exponent = exponent + log_column.unsqueeze(-2)
        matching, log_u, log_v = _Rounds.apply(
            exponent.exp_(), log_row.exp(), log_column.exp(), min(_ROUNDS_AT_ONCE, rounds - done)
        )
        log_row, log_column = log_row + log_u, log_column + log_v
    return matching


class _Rounds(torch.autograd.Function):
    """Rounds on a matrix K with slack column a and slack row b, and their derivative.

    u_t = 1 / (K v_{t−1} + a) and v_t = 1 / (Kᵀ u_t + b), from v_0 = 1; the results are
    diag(u) K diag(v), log u and log v. In the backward pass the gradients of log u_t and log v_t
    are carried along, which are of moderate size whatever u and v are. Each use of K adds an outer
    product of two vectors to its gradient; one product of matrices adds up all of them.
    """

    @staticmethod
    def forward(
        ctx: Any, matrix: Tensor, slack_column: Tensor, slack_row: Tensor, rounds: int
    ) -> tuple[Tensor, Tensor, Tensor]:
        us = matrix.new_empty(rounds, *slack_column.shape)
        vs = matrix.new_ones(rounds + 1, *slack_row.shape)
        # Without a backward pass to come, nobody needs the matrix any more.
        scaled = torch.empty_like(matrix) if any(ctx.needs_input_grad) else matrix
        for one in _portions(matrix):
            K = matrix[one]
            for t in range(rounds):
                us[t, one] = (_times(K, vs[t, one]) + slack_column[one]).reciprocal()
                vs[t + 1, one] = (_times(K.mT, us[t, one]) + slack_row[one]).reciprocal()
            torch.mul(K, us[-1, one].unsqueeze(-1), out=scaled[one])
            scaled[one].mul_(vs[-1, one].unsqueeze(-2))
        ctx.save_for_backward(matrix, us, vs)
        return scaled, us[-1].log(), vs[-1].log()

    @staticmethod
    @once_differentiable
    def backward(
        ctx: Any, grad: Tensor, grad_log_u: Tensor, grad_log_v: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, None]:
        matrix, us, vs = ctx.saved_tensors
        # Gradients of the sums that u_t and v_t are the reciprocals of.
        row_sums, column_sums = torch.empty_like(us), torch.empty_like(vs[1:])
        grad_matrix = torch.empty_like(matrix)
        for one in _portions(matrix):
            K = matrix[one]
            grad_K = torch.mul(grad[one], us[-1, one].unsqueeze(-1), out=grad_matrix[one])
            grad_K.mul_(vs[-1, one].unsqueeze(-2))
            through = grad_K * K
            grad_u = grad_log_u[one] + through.sum(-1)
            grad_v = grad_log_v[one] + through.sum(-2)
            for t in reversed(range(len(us))):
                column_sums[t, one] = -grad_v * vs[t + 1, one]
                grad_u = grad_u + us[t, one] * _times(K, column_sums[t, one])
                row_sums[t, one] = -grad_u * us[t, one]
                grad_v = vs[t, one] * _times(K.mT, row_sums[t, one])
                grad_u = torch.zeros_like(grad_u)  # only the last u is part of the results
            left = torch.cat([us[:, one], row_sums[:, one]])
            right = torch.cat([column_sums[:, one], vs[:-1, one]])
            grad_K.baddbmm_(left.permute(1, 2, 0), right.transpose(0, 1))
        return grad_matrix, row_sums.sum(0), column_sums.sum(0), None


def _portions(matrix: Tensor) -> list[slice]:
    """Batch items to work on together: on a CPU one, which then stays in its cache."""
    if matrix.device.type == "cpu":
        return [slice(i, i + 1) for i in range(len(matrix))]
    return [slice(None)]


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)
