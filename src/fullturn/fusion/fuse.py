"""Many scans of an object, in any order and pose, become one cloud."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from fullturn.errors import InputError, is_number, whole_number
from fullturn.fusion.cache import EdgeCache
from fullturn.fusion.connect import connect_groups, connect_scans, refine_groups
from fullturn.fusion.edges import Edge, Registrar
from fullturn.fusion.graph import GraphConfig, Placement
from fullturn.fusion.merge import MergedCloud, merge_clouds
from fullturn.fusion.optimize import gtsam
from fullturn.fusion.recheck import recheck_scans
from fullturn.fusion.result import FusedEdge, Fusion
from fullturn.fusion.scans import Scan, check_scans, scan_names, thinned
from fullturn.fusion.settle import settle_groups
from fullturn.methods.check import make_method
from fullturn.normalize import Normalization
from fullturn.threads import torch_threads
from fullturn.workers import check_workers

_CELL = 1.5  # of the merged cloud, in spacings


@torch_threads(1)
def fuse(
    clouds: Sequence[Any],
    *,
    viewpoints: Sequence[Any] | None = None,
    method: str = "auto",
    seed: int = 0,
    min_probability: float = 0.8,
    workers: int | None = 1,
    cache: str | os.PathLike[str] | None = None,
    progress: bool = False,
) -> Fusion:
    """Find the pose of every scan and merge them; scans that don't connect stay apart.

    A cloud is whatever `register` takes, all in one unit. `viewpoints` says where the sensors
    stood: three numbers in each cloud's own frame, or None where that isn't known. Two groups of
    scans are joined where the poses between them are right with at least `min_probability`. Up to
    12 scans, all pairs are registered; of more, the most alike first, until all are connected or 10
    pairs a scan are done. Groups that remain are registered as whole clouds.
    `workers` is how many processes register pairs; None: one per CPU. The default, 1, stays in this
    process, unlike that of `register_many`: several start afresh ("spawn"), so that a script must
    call this from under ``if __name__ == "__main__":``. With a `cache` folder, finished pairs
    are kept, and a fusion that was stopped goes on where it was. The result is the same for any
    number of workers, and from a cache.

    Raises:
        InputError: fewer than two usable scans, another argument that cannot be used, or a cache
            folder that holds something else.
        DependencyError: gtsam is missing (``pip install "fullturn[fuse]"``).
        WriteError: the cache cannot be written.
    """
    begin = time.perf_counter()
    gtsam()  # says now, and not after the work, that a package is missing
    whole_number(seed, "seed", least=0)
    name = make_method(method).name
    workers = check_workers(workers)
    if not is_number(min_probability) or not 0.0 < min_probability <= 1.0:
        raise InputError(
            f"min_probability: expected a number above 0 and up to 1, got {min_probability!r}"
        )
    config = GraphConfig(min_probability=float(min_probability))
    kept = None if cache is None else EdgeCache(cache)
    scans, notes = check_scans(clouds, viewpoints)
    length = float(np.median([scan.radius for scan in scans]))
    surfaces = [thinned(scan, length) for scan in scans]
    loaded = time.perf_counter()

    with Registrar(
        length=length, method=method, seed=seed, workers=workers, cache=kept
    ) as registrar:
        edges, placement = connect_scans(
            registrar, scans, length, surfaces, config, progress=progress
        )
        edges, placement = connect_groups(
            registrar, scans, length, surfaces, config, edges, placement, progress=progress
        )
        connected = time.perf_counter()

        poses, covariance = refine_groups(scans, length, edges, placement)
        placement, changed = settle_groups(scans, length, edges, placement, poses, config)
        if changed:
            poses, covariance = refine_groups(scans, length, edges, placement)
        edges, placement, changed = recheck_scans(
            registrar, scans, length, surfaces, config, edges, placement, poses, progress=progress
        )
        if changed:
            poses, covariance = refine_groups(scans, length, edges, placement)
    refined = time.perf_counter()
    worlds, covariances = _denormalized(scans, length, placement, poses, covariance)
    merged = tuple(_merged([scans[s] for s in g], worlds[list(g)]) for g in placement.groups)
    end = time.perf_counter()

    if kept is not None and kept.before > kept.used:
        notes.append(
            f"the cache holds {kept.before - kept.used} pairs of other scans, settings or versions;"
            " they were not used"
        )
    failed = [edge for edge in edges if edge.error is not None]
    if failed:
        notes.append(f"{len(failed)} of {len(edges)} pairs failed, first: {failed[0].error}")
    if len(placement.groups) > 1:
        notes.append(f"the scans form {len(placement.groups)} groups that nothing firmly connects")
    seconds = {
        "check": loaded - begin,
        "register": connected - loaded,
        "refine": refined - connected,
        "merge": end - refined,
        "total": end - begin,
    }
    return _result(
        clouds, scans, edges, placement, worlds, covariances, merged, name, seconds, notes
    )


def _denormalized(
    scans: Sequence[Scan],
    length: float,
    placement: Placement,
    poses: np.ndarray,
    covariance: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Both in the input's unit and frames; the world is the frame of a group's first scan."""
    worlds, covariances = poses.copy(), covariance.copy()
    for group in placement.groups:
        first = scans[group[0]]
        for number in group:
            frame = Normalization(scans[number].center, first.center, length)
            worlds[number] = frame.denormalize(poses[number])
            covariances[number] = frame.denormalize_covariance(covariance[number])
    return worlds, covariances


def _merged(scans: Sequence[Scan], worlds: np.ndarray) -> MergedCloud:
    middle = scans[0].center
    spacing = [scan.spacing for scan in scans]
    cell = _CELL * float(np.median(spacing)) or scans[0].radius * 1e-6

    def moved() -> Iterator[np.ndarray]:
        for scan, T in zip(scans, worlds, strict=True):
            # Relative to the first scan's center, so that cells stay exact far from the origin.
            shift = T[:3, :3] @ scan.center + T[:3, 3] - middle
            yield scan.points() @ T[:3, :3].T + shift

    merged = merge_clouds(moved(), cell)
    return MergedCloud(merged.points + middle, merged.count)


def _result(
    clouds: Sequence[Any],
    scans: Sequence[Scan],
    edges: Sequence[Edge],
    placement: Placement,
    worlds: np.ndarray,
    covariances: np.ndarray,
    merged: tuple[MergedCloud, ...],
    method: str,
    seconds: dict[str, float],
    notes: Sequence[str],
) -> Fusion:
    """Everything by the places in the list of clouds that was given."""
    at = {scan.number: place for place, scan in enumerate(scans)}
    numbers = range(len(clouds))
    group_of = {s: number for number, group in enumerate(placement.groups) for s in group}

    def fused(edge: Edge, chosen: int) -> FusedEdge:
        return FusedEdge(
            scans[edge.target].number,
            scans[edge.source].number,
            tuple(float(p) for p in edge.probability),
            chosen,
            edge.overlap[max(chosen, 0)] if edge.overlap else (0.0, 0.0),
            edge.error,
            *(tuple(scans[scan].number for scan in side) for side in edge.sides),
        )

    return Fusion(
        names=tuple(scan_names(clouds)),
        T_world_scan=tuple(worlds[at[n]] if n in at else None for n in numbers),
        group=tuple(group_of[at[n]] if n in at else -1 for n in numbers),
        groups=tuple(tuple(scans[s].number for s in group) for group in placement.groups),
        probability=tuple(
            float(placement.probability[at[n]]) if n in at else float("nan") for n in numbers
        ),
        covariance=tuple(covariances[at[n]] if n in at else None for n in numbers),
        edges=tuple(fused(e, c) for e, c in zip(edges, placement.chosen, strict=True)),
        merged=merged,
        method=method,
        seconds=seconds,
        notes=tuple(notes),
    )
