"""Turns of a surface onto itself: poses that differ by one are equally right."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from fullturn.geometry.motion import invert, move

_ASKED = 150  # points of a surface
_MOST_KINDS = 16  # of poses; the others are no other's turns


class Surface:
    """The points of a surface (N, 3), and whether motions of it leave it as it is."""

    def __init__(self, points: Float[np.ndarray, "n 3"]) -> None:
        self._tree = cKDTree(points)
        self._some = points[:: -(-len(points) // _ASKED)]
        # Two samples of one surface do not lie on one another.
        self._gap = float(self._tree.query(self._some, k=[min(2, len(points))])[0].mean())
        self._size = float(np.linalg.norm(np.ptp(points, axis=0)))

    def stays(self, motion: Float[np.ndarray, "4 4"], *, within: float) -> bool:
        """Whether it lies on itself when moved, on average within that share of its size.

        Both ways: a part may lie on a whole that it isn't.
        """
        reach = within * self._size + self._gap
        both = (move(T, self._some) for T in (motion, invert(motion)))
        return all(self._tree.query(moved)[0].mean() < reach for moved in both)


def same_but_for_turns(
    T_one_other: Float[np.ndarray, "k 4 4"],
    probability: Float[np.ndarray, " k"],
    one: Surface,
    other: Surface,
    *,
    within: float,
) -> Bool[np.ndarray, "k k"]:
    """Which relative poses of two surfaces differ by a turn of either onto itself.

    The most probable pose of each kind stands for it.
    """
    kind = np.full(len(T_one_other), -1)
    first: list[int] = []
    for pose in np.argsort(-probability, kind="stable"):
        T = T_one_other[pose]
        for number, known in enumerate(first[:_MOST_KINDS]):
            back = invert(T_one_other[known])
            if one.stays(T @ back, within=within) or other.stays(back @ T, within=within):
                kind[pose] = number
                break
        else:
            kind[pose] = len(first)
            first.append(int(pose))
    result: np.ndarray = kind[:, None] == kind
    return result
