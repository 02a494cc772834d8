"""The scans that can be fused, and what is kept of each while its points stay where they are."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.errors import FullturnError, InputError
from fullturn.geometry.cloud import Cloud
from fullturn.io import LoadedCloud, load_cloud

_SAMPLE_POINTS = 4_000  # per scan, for the joint refinement
_RADIUS_QUANTILE = 0.99  # a few stray points don't count
_UNLIKE_SIZE, _UNLIKE_SPACING = 10.0, 10.0


@dataclass(frozen=True, eq=False)
class Scan:
    """What is kept of a scan; a file's points are read again where all of them are needed."""

    number: int  # its place in the list that was given
    name: str
    origin: str | LoadedCloud
    key: str  # hash of its points
    count: int
    center: np.ndarray  # (3,) mean, in the input's frame and unit
    radius: float  # in the input's unit, as is the spacing
    spacing: float
    sample: Float[Tensor, "s 3"]  # less the center, in the input's unit
    sample_normals: Float[Tensor, "s 3"]
    notes: tuple[str, ...]

    def points(self) -> np.ndarray:
        """All points (N, 3) less the center, in the input's unit."""
        return centered_points(self.origin, self.center)


def centered_points(origin: str | LoadedCloud, center: np.ndarray) -> np.ndarray:
    """The points of a file or a loaded cloud, less `center`."""
    loaded = origin if isinstance(origin, LoadedCloud) else load_cloud(origin)
    return loaded.points - center


def check_scans(clouds: Sequence[Any]) -> tuple[list[Scan], list[str]]:
    """The usable scans, and notes on those left out: unreadable, empty, or there twice.

    Raises:
        InputError: fewer than two scans, or fewer than two that can be used.
    """
    if isinstance(clouds, (str, bytes)) or not isinstance(clouds, Sequence) or len(clouds) < 2:
        got = f"{len(clouds)}" if isinstance(clouds, Sequence) else f"a {type(clouds).__name__}"
        raise InputError(f"clouds: expected a list of at least 2 scans, got {got}; add scans")
    scans: list[Scan] = []
    notes: list[str] = []
    first: dict[str, Scan] = {}
    for number, cloud in enumerate(clouds):
        try:
            scan = _scan(number, cloud)
        except FullturnError as error:
            notes.append(f"left out scan {number + 1}: {error}")
            continue
        notes += scan.notes
        if scan.key in first:
            twin = first[scan.key].name
            notes.append(f"left out {scan.name}: it holds the same points as {twin}")
            continue
        first[scan.key] = scan
        scans.append(scan)
    if len(scans) < 2:
        raise InputError(
            f"clouds: expected at least 2 usable scans, got {len(scans)} of {len(clouds)} "
            f"({'; '.join(notes)}); add scans"
        )
    return scans, notes + _unlike(scans)


def _scan(number: int, cloud: Any) -> Scan:
    is_file = isinstance(cloud, (str, os.PathLike))
    role = None if is_file or isinstance(cloud, LoadedCloud) else f"scan {number + 1}"
    loaded = load_cloud(cloud, name=role)
    points = loaded.points
    # Taking one point off first keeps the mean exact far from the origin.
    center = points[0] + (points - points[0]).mean(axis=0)
    seen = Cloud(torch.from_numpy(points - center))
    every = -(-len(seen.sample) // _SAMPLE_POINTS)
    return Scan(
        number=number,
        name=loaded.name,
        origin=os.fspath(cloud) if is_file else loaded,
        key=hashlib.sha256(points.tobytes()).hexdigest(),
        count=len(points),
        center=center,
        radius=float(np.quantile(np.linalg.norm(points - center, axis=1), _RADIUS_QUANTILE)),
        spacing=seen.spacing,
        sample=seen.sample[::every].clone(),  # a view would keep all points in memory
        sample_normals=seen.sample_normals[::every].clone(),
        notes=loaded.notes,
    )


def _unlike(scans: list[Scan]) -> list[str]:
    """What is said where sizes or densities differ so much that something may be wrong."""
    notes = []
    radius = float(np.median([scan.radius for scan in scans]))
    spacing = float(np.median([scan.spacing for scan in scans]))
    for scan in scans:
        size, gap = scan.radius / radius, scan.spacing / spacing if spacing else 1.0
        if not 1 / _UNLIKE_SIZE < size < _UNLIKE_SIZE:
            notes.append(f"{scan.name} is {size:.3g} times as large as most: is its unit another?")
        elif not 1 / _UNLIKE_SPACING < gap < _UNLIKE_SPACING:
            notes.append(f"{scan.name} has {gap:.3g} times the point spacing of most scans")
    return notes
