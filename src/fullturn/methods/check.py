"""Asking a method, and whether its answer is one: anybody may write a method."""

from __future__ import annotations

import math
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fullturn.errors import FullturnError, InputError, is_number, one_line
from fullturn.geometry.cloud import Cloud
from fullturn.methods.base import Estimate, Method
from fullturn.methods.registry import get, names

_RIGID = 1e-6  # how far RᵀR may be from I, per entry
_ROUNDING = 1e-6  # of probabilities


def make_method(name: Any) -> Method:
    """A method by any name that `registry.get` knows.

    Raises:
        InputError: no such method.
        DependencyError: the method's package is missing.
        FullturnError: it cannot be made; what it raised is the cause.
    """
    found = get(name)
    with _failures_named(found, found.name):
        return found()


def run_method(
    method: Method,
    source: Cloud,
    target: Cloud,
    *,
    rng: np.random.Generator,
    max_rotation_deg: float | None = None,
) -> Estimate:
    """What a method answers, checked; it is told the largest rotation where it takes one.

    Raises:
        InputError: the method returned something else than an estimate.
        FullturnError: it failed; what it raised is the cause.
    """
    told: dict[str, Any] = {}
    limit = rotation_limit_rad(max_rotation_deg)
    if method.traits.limits_rotation and limit is not None:
        told["max_rotation_rad"] = limit
    with _failures_named(type(method), f"{method.name}, estimate()"):
        estimate = method.estimate(source, target, rng=rng, **told)
    return checked_estimate(estimate, method.name)


@contextmanager
def _failures_named(method: type[Method], what: str) -> Iterator[None]:
    """Whatever a method raises becomes one error that says whose it is and where it happened."""
    try:
        yield
    except (FullturnError, MemoryError):
        raise
    except (Exception, SystemExit) as error:
        home = getattr(sys.modules.get(method.__module__), "__file__", None)
        frames = traceback.extract_tb(error.__traceback__)
        place = ([f for f in frames if f.filename == home] or frames)[-1]
        raise FullturnError(
            f"method {what}: {type(error).__name__}: {one_line(error)[:300]} "
            f"({Path(place.filename).name}, line {place.lineno})"
        ) from error


def rotation_limit_rad(max_rotation_deg: float | None) -> float | None:
    """The largest possible rotation; None where none is known, and for 180°, which is no limit."""
    if max_rotation_deg is None or max_rotation_deg >= 180.0:
        return None
    return math.radians(max_rotation_deg)


def check_max_rotation(max_rotation_deg: Any, method: type[Method]) -> float | None:
    """The largest possible rotation in degrees, None where none is known.

    Raises:
        InputError: not a number above 0 and up to 180, or the method doesn't take one.
    """
    if max_rotation_deg is None:
        return None
    # The smallest floats are 0 in radians.
    if not is_number(max_rotation_deg) or not 0.0 < math.radians(max_rotation_deg) <= math.pi:
        raise InputError(
            "max_rotation_deg: expected an angle above 0 and up to 180, or None, got "
            f"{max_rotation_deg!r:.80}"
        )
    if not method.traits.limits_rotation:
        takers = ", ".join(name for name in names() if get(name).traits.limits_rotation)
        raise InputError(
            f"max_rotation_deg: expected a method that takes one ({takers}), got {method.name}; "
            "choose one of these, or leave the limit out"
        )
    return float(max_rotation_deg)


def checked_estimate(estimate: Any, name: str) -> Estimate:
    """The estimate in float64, if its poses are rigid and its probabilities are some, best first.

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
    T = T.detach().double()
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
    stated = stated.detach().double()
    if not (bool((stated >= 0.0).all()) and float(stated.sum()) <= 1.0 + _ROUNDING):
        raise InputError(
            f"method {name}: expected probabilities from 0 that sum to at most 1, got "
            f"{_numbers(stated)}"
        )
    if bool((stated.diff() > _ROUNDING).any()):
        raise InputError(
            f"method {name}: expected the most probable pose first, got probabilities of "
            f"{_numbers(stated)}; sort both"
        )
    return stated


def _told(value: Any) -> str:
    if isinstance(value, Tensor):
        return f"shape {tuple(value.shape)}"
    return f"a {type(value).__name__}"


def _numbers(values: Tensor) -> str:
    return " ".join(f"{x:.4g}" for x in values.flatten().tolist()[:16])
