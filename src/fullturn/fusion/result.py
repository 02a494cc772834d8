"""What a fusion returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fullturn.fusion.merge import MergedCloud


@dataclass(frozen=True, eq=False)
class FusedEdge:
    """One registered pair, as numbers into the list of clouds that was given.

    Where whole groups were registered, each as one cloud, the pose is that of their first scans.
    """

    target: int
    source: int
    probability: tuple[float, ...]  # of its poses, ranked; empty where the registration failed
    chosen: int  # the pose that agrees with the fusion, −1: none
    overlap: tuple[float, float]  # (source share, target share) of that pose, or of the first
    error: str | None = None
    target_scans: tuple[int, ...] = ()  # all that the target's cloud was made of: one, or a group
    source_scans: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class Fusion:
    """Where each scan is, which ones belong together, and the merged clouds.

    The world of the largest group is the frame of its first scan; every other group is in the frame
    of its own first scan. Lengths are in the unit of the input. All tuples follow the list of
    clouds that was given.
    """

    names: tuple[str, ...]
    T_world_scan: tuple[np.ndarray | None, ...]  # (4, 4); None: left out
    group: tuple[int, ...]  # of each scan, 0 the largest; −1: left out
    groups: tuple[tuple[int, ...], ...]  # the same as lists of scans, the largest first
    probability: tuple[float, ...]  # that a scan's pose in its group is right; NaN where alone
    covariance: tuple[np.ndarray | None, ...]  # (6, 6) relative to the group's first scan: rotation
    # vector (rad), then translation, right perturbation, as in `Registration`
    edges: tuple[FusedEdge, ...]
    merged: tuple[MergedCloud, ...]  # one per group
    method: str
    seconds: dict[str, float]
    notes: tuple[str, ...] = ()

    @property
    def points(self) -> np.ndarray:
        """The merged cloud (n, 3) of the largest group."""
        return self.merged[0].points
