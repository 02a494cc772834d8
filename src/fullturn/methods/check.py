"""Whether a method's answer is one: anybody may write a method."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from fullturn.errors import InputError
from fullturn.methods.base import Estimate

_RIGID = 1e-6  # how far RᵀR may be from I, per entry


def checked_estimate(estimate: Any, name: str) -> Estimate:
    """The estimate in float64, if its poses are rigid and its probabilities are some.

    Raises:
        InputError: the method called `name` returned something else.
    """
    if not isinstance(estimate, Estimate):
        raise InputError(
            f"method {name}: expected an Estimate from estimate(), got a {type(estimate).__name__}"
        )
    T = estimate.T_target_source
    if not isinstance(T, Tensor) or T.ndim != 3 or T.shape[1:] != (4, 4) or len(T) == 0:
        raise InputError(
            f"method {name}: expected T_target_source to be a tensor of shape (k, 4, 4) with k of "
            f"at least 1, got {_told(T)}"
        )
    T = T.double()
    R = T[:, :3, :3]
    apart = (R.mT @ R - torch.eye(3).to(R)).abs().max()
    bottom = T[:, 3] == T.new_tensor([0.0, 0.0, 0.0, 1.0])
    # Written so that NaN fails, too.
    rigid = bool(apart <= _RIGID) and bool((torch.linalg.det(R) > 0.0).all()) and bool(bottom.all())
    if not rigid or not bool(T.isfinite().all()):
        raise InputError(
            f"method {name}: expected rigid poses [R t; 0 1] with RᵀR = I to {_RIGID:g} and "
            f"det R = 1, got {_numbers(T[0])}"
        )
    return replace(
        estimate,
        T_target_source=T,
        success_probability=_probabilities(estimate.success_probability, len(T), name),
    )


def _probabilities(stated: Any, count: int, name: str) -> Tensor | None:
    if stated is None:
        return None
    if not isinstance(stated, Tensor) or stated.shape != (count,):
        raise InputError(
            f"method {name}: expected one success_probability for each of the {count} poses, or "
            f"None, got {_told(stated)}"
        )
    stated = stated.double()
    if not (bool((stated >= 0.0).all()) and float(stated.sum()) <= 1.0 + 1e-6):
        raise InputError(
            f"method {name}: expected probabilities from 0 that sum to at most 1, got "
            f"{_numbers(stated)}"
        )
    return stated


def _told(value: Any) -> str:
    if isinstance(value, Tensor):
        return f"shape {tuple(value.shape)}"
    return f"a {type(value).__name__}"


def _numbers(values: Tensor) -> str:
    return " ".join(f"{x:.4g}" for x in values.flatten().tolist()[:16])
