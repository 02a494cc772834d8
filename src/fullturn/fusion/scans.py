"""The scans that can be fused, and what is kept of each while its points stay where they are."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.errors import FullturnError, InputError, one_line
from fullturn.geometry.cloud import Cloud
from fullturn.geometry.extent import center_and_radius, far_from_the_rest
from fullturn.geometry.sampling import voxel_sample
from fullturn.io import LoadedCloud, load_cloud
from fullturn.io.check import as_viewpoint
from fullturn.normalize import stray_notes

_SAME = 0.01  # of the spacing, within which single precision keeps points
_SAMPLE_POINTS = 4_000  # per scan, for the joint refinement
_UNLIKE_SIZE, _UNLIKE_SPACING = 10.0, 10.0
CELL = 0.07  # of a thinned scan, in units of the fusion: about 700 points


@dataclass(frozen=True, eq=False)
class Body:
    """What is registered as one cloud: a scan, or several that are held together."""

    key: str  # hash of all that the cloud depends on
    origin: str | LoadedCloud
    center: np.ndarray  # (3,) mean, in the origin's frame and the input's unit
    viewpoint: np.ndarray | None  # (3,) where the sensor stood, likewise

    def points(self) -> np.ndarray:
        """All points (N, 3) less the center, in the input's unit."""
        loaded = self.origin if isinstance(self.origin, LoadedCloud) else load_cloud(self.origin)
        return loaded.points - self.center


@dataclass(frozen=True, eq=False)
class Scan(Body):
    """What is kept of a scan; a file's points are read again where all of them are needed."""

    number: int  # its place in the list that was given
    name: str
    twin_key: str  # hash of its points in single precision, whatever their order
    count: int
    radius: float  # in the input's unit, as is the spacing
    spacing: float
    sample: Float[Tensor, "s 3"]  # less the center, in the input's unit; no stray points
    sample_normals: Float[Tensor, "s 3"]
    notes: tuple[str, ...]

    @property
    def sample_spacing(self) -> float:
        """About how far apart sampled points lie: on a surface, 1 / √share as far as all."""
        return self.spacing * (self.count / len(self.sample)) ** 0.5


def thinned(scan: Scan, length: float) -> Float[np.ndarray, "m 3"]:
    """Voxel means of a scan less its center, in units of the fusion."""
    points: np.ndarray = voxel_sample(scan.sample / length, CELL)[0].double().numpy()
    return points


def check_scans(
    clouds: Sequence[Any], viewpoints: Sequence[Any] | None = None
) -> tuple[list[Scan], list[str]]:
    """The usable scans, and notes on those left out: unreadable, empty, or there twice.

    Raises:
        InputError: fewer than two scans, or fewer than two that can be used, or viewpoints that
            cannot be.
    """
    is_list = isinstance(clouds, Sequence) and not isinstance(clouds, (str, bytes))
    if not is_list or len(clouds) < 2:
        got = f"{len(clouds)}; add scans" if is_list else f"a {type(clouds).__name__}; give a list"
        raise InputError(f"clouds: expected a list of at least 2 scans, got {got}")
    eyes = check_viewpoints(viewpoints, len(clouds))
    names = scan_names(clouds)
    scans: list[Scan] = []
    notes: list[str] = []
    first: dict[str, Scan] = {}
    for number, (cloud, eye) in enumerate(zip(clouds, eyes, strict=True)):
        try:
            scan = _scan(number, cloud, eye, names[number])
        except FullturnError as error:
            notes.append(f"left out scan {number + 1}: {error}")
            continue
        notes += scan.notes
        twin = first.setdefault(scan.twin_key, scan)
        if twin is not scan:
            notes.append(f"left out {scan.name}: it holds the same points as {twin.name}")
            continue
        scans.append(scan)
    if len(scans) < 2:
        raise InputError(
            f"clouds: expected at least 2 usable scans, got {len(scans)} of {len(clouds)} "
            f"({'; '.join(notes)}); add scans"
        )
    return scans, notes + _unlike(scans)


def scan_names(clouds: Sequence[Any]) -> list[str]:
    """What scans are called: files by as little of their paths as tells them apart."""
    parts = [
        Path(cloud).parts if isinstance(cloud, (str, os.PathLike)) else None for cloud in clouds
    ]
    names = []
    for number, (cloud, own) in enumerate(zip(clouds, parts, strict=True), start=1):
        if own is None:
            names.append(cloud.name if isinstance(cloud, LoadedCloud) else f"scan {number}")
            continue
        others = [other for other in parts if other is not None and other != own]
        length = 1
        while length < len(own) and any(other[-length:] == own[-length:] for other in others):
            length += 1
        names.append(one_line("/".join(own[-length:])))
    return names


def check_viewpoints(viewpoints: Sequence[Any] | None, count: int) -> list[np.ndarray | None]:
    """One place (3,) or None per scan.

    Raises:
        InputError: another number of them, or one that is no place.
    """
    if viewpoints is None:
        return [None] * count
    if isinstance(viewpoints, (str, bytes)) or not hasattr(viewpoints, "__len__"):
        raise InputError(
            "viewpoints: expected a list with three numbers or None for each scan, got a "
            f"{type(viewpoints).__name__}"
        )
    if len(viewpoints) != count:
        raise InputError(
            f"viewpoints: expected one per scan, {count}, got {len(viewpoints)}; give None where "
            "a sensor's place isn't known"
        )
    return [
        as_viewpoint(eye, f"viewpoints: scan {number}", frame="scan's own")
        for number, eye in enumerate(viewpoints, start=1)
    ]


def _twin_key(points: np.ndarray, spacing: float) -> str:
    with np.errstate(over="ignore"):  # of strays alone
        rounded = points.astype(np.float32)
    if np.abs(rounded - points).max() > _SAME * spacing:  # far from the origin
        rounded = points
    return hashlib.sha256(rounded[np.lexsort(rounded.T)].tobytes()).hexdigest()


def _scan(number: int, cloud: Any, eye: np.ndarray | None, name: str) -> Scan:
    is_file = isinstance(cloud, (str, os.PathLike))
    role = None if is_file or isinstance(cloud, LoadedCloud) else name
    loaded = load_cloud(cloud, name=role)
    points = loaded.points
    center, radius = center_and_radius(points)
    near = points[~far_from_the_rest(points, center, radius)]
    seen = Cloud(torch.from_numpy(near - center))
    every = -(-len(seen.sample) // _SAMPLE_POINTS)
    points_key = hashlib.sha256(points.tobytes()).hexdigest()
    return Scan(
        key=points_key if eye is None else f"{points_key} {eye.tolist()}",
        origin=os.fspath(cloud) if is_file else loaded,
        center=center,
        viewpoint=eye,
        number=number,
        name=name,
        twin_key=_twin_key(points, seen.spacing),
        count=len(points),
        radius=radius,
        spacing=seen.spacing,
        sample=seen.sample[::every].clone(),  # a view would keep all points in memory
        sample_normals=seen.sample_normals[::every].clone(),
        notes=(*loaded.notes, *stray_notes(name, points, center, radius)),
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
