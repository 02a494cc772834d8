"""Decide whether values can be registered: shape, type, values, and enough shape to hold a pose."""

from __future__ import annotations

import numpy as np

from fullturn.errors import InputError, one_line
from fullturn.geometry.extent import strays

# Squares, and sums of squares over millions of points, stay within float64 between these.
_LARGEST, _SMALLEST = 1e150, 1e-140
_COLLINEAR = 1e-6


def as_points(values: object, name: str) -> np.ndarray:
    """`values` as a new float64 array (N, 3) of finite points that determine a pose.

    Raises:
        InputError: anything `check_shape` or `check_pose` names, or NaN or infinite values.
    """
    array = check_shape(values, name)
    with np.errstate(over="ignore"):  # longer floats may leave float64, and are infinite then
        points = array.astype(np.float64)  # a copy: the input is never touched
    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        raise InputError(
            f"{name}: expected finite points, {int(bad.sum())} of {len(points)} hold NaN or "
            f"infinity, the first in row {int(bad.argmax())}; remove them"
        )
    check_pose(points, name, precision=precision_of(array.dtype))
    return points


def as_viewpoint(viewpoint: object, name: str, *, frame: str) -> np.ndarray | None:
    """Where a sensor stood, as a new float64 array (3,); None stays None.

    `frame` says whose frame it is in, as in "scene's".

    Raises:
        InputError: not three finite numbers.
    """
    if viewpoint is None:
        return None
    try:
        place = np.asarray(viewpoint, dtype=np.float64).copy()
    except (ValueError, TypeError, RuntimeError) as error:
        raise InputError(f"{name}: expected three numbers, got {viewpoint!r:.80}") from error
    if place.shape != (3,) or not np.isfinite(place).all():
        got = f"shape {place.shape}" if place.shape != (3,) else f"{place.tolist()}"
        raise InputError(
            f"{name}: expected three finite numbers, where the sensor stood in the {frame} frame; "
            f"got {got}"
        )
    return place


def check_shape(values: object, name: str) -> np.ndarray:
    """`values` as a real array (N, 3), N ≥ 1, without a copy where it is one.

    Raises:
        InputError: another shape, no points, or a type that is not real numbers.
    """
    try:
        array = np.asarray(values)
    # Whatever an object's own conversion raises: ragged lists, unfinished tensors, ...
    except Exception as error:
        raise InputError(
            f"{name}: expected points as an (N, 3) array, cannot make an array of "
            f"{_kind(values)} ({one_line(error)[:120]}); give rows of three numbers"
        ) from error
    if np.ma.is_masked(values):
        raise InputError(f"{name}: expected unmasked points, found masked ones; remove those")
    if array.size == 0:
        raise InputError(
            f"{name}: expected at least 3 points, it is empty (shape {array.shape}); "
            "check where it comes from"
        )
    if array.dtype.kind not in "fiu":
        raise InputError(
            f"{name}: expected real numbers, found dtype {one_line(array.dtype)[:80]} from "
            f"{_kind(values)}; convert it to float64"
        )
    if array.ndim == 2 and array.shape[0] == 3 and array.shape[1] != 3:
        raise InputError(
            f"{name}: expected shape (N, 3), one point per row, found {array.shape}; "
            "transpose it (points.T)"
        )
    if array.ndim == 3 and array.shape[2] == 3:
        raise InputError(
            f"{name}: expected one cloud of shape (N, 3), found the batch {array.shape}; "
            "give one item at a time, or use register_many"
        )
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(
            f"{name}: expected shape (N, 3), one point per row, found {array.shape}; "
            "give the columns x, y and z"
        )
    return array


def check_pose(points: np.ndarray, name: str, *, precision: float) -> None:
    """Check that finite points (n, 3) can determine a pose: size, distinctness, not a line.

    Points count as collinear when the second singular value of the centered points is at most
    1e-6 of the first, or, per point, at most 4 `precision` times the largest coordinate: what
    rounding alone makes of a line at that distance from the origin. Stray points, beside which
    anything looks like a line, don't count then.

    Raises:
        InputError: fewer than 3 distinct points, a line, or sizes whose squares leave float64.
    """
    if len(points) == 0:
        raise InputError(
            f"{name}: expected at least 3 points, it is empty; check where it comes from"
        )
    distinct = _distinct_up_to_three(points)
    if distinct < 3:
        raise InputError(
            f"{name}: expected at least 3 distinct points, found {distinct} among {len(points)}; "
            "a pose needs more"
        )
    largest = float(np.abs(points).max())
    extent = float((points.max(axis=0) / 2 - points.min(axis=0) / 2).max())
    if largest > _LARGEST or extent < _SMALLEST:
        raise InputError(
            f"{name}: expected coordinates below {_LARGEST:g} and an extent above "
            f"{_SMALLEST:g}, found {largest:g} and {extent:g}; rescale it, or remove "
            "points that are none"
        )
    # Taking one of the points off first keeps the mean exact far from the origin.
    centered = (points - points[0]) / extent
    centered -= centered.mean(axis=0)
    squares = np.linalg.eigvalsh(centered.T @ centered / len(points))
    first, second = np.sqrt(np.maximum(squares[[2, 1]], 0.0))
    rounding = 4.0 * precision * (largest / extent)
    if second > max(_COLLINEAR * first, rounding):
        return
    stray = strays(points)
    if stray.any():
        check_pose(points[~stray], name, precision=precision)
        return
    if second > _COLLINEAR * first:
        raise InputError(
            f"{name}: expected points that span at least a plane, all {len(points)} lie on one "
            f"line as far as their coordinates can tell (up to {largest:.3g}, in steps of up to "
            f"{precision * largest:.2g}); save them in double precision, or subtract an offset"
        )
    raise InputError(
        f"{name}: expected points that span at least a plane, all {len(points)} lie on one "
        f"line (thickness {second * extent:.2g}, length {first * extent:.2g}, rounding "
        f"{rounding * extent:.2g}); a line leaves the pose open"
    )


def precision_of(dtype: np.dtype) -> float:
    """The relative rounding of values that came in `dtype`; integers and float64 alike.

    >>> precision_of(np.dtype("float32")) == 2.0**-23
    True
    """
    if dtype.kind == "f" and dtype.itemsize < 8:
        return float(np.finfo(dtype).eps)
    return float(np.finfo(np.float64).eps)


def _distinct_up_to_three(points: np.ndarray) -> int:
    others = points[(points != points[0]).any(axis=1)]
    if len(others) == 0:
        return 1
    return 3 if (others != others[0]).any() else 2


def _kind(values: object) -> str:
    return f"a {type(values).__module__}.{type(values).__qualname__}".replace("builtins.", "")
