"""The front door: check → normalize → estimate → explain → denormalize."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from fullturn.batch import RegistrationInterrupted, register_many
from fullturn.errors import whole_number
from fullturn.geometry.cloud import Cloud
from fullturn.io import LoadedCloud, load_cloud
from fullturn.io.check import as_viewpoint
from fullturn.methods.check import (
    check_max_rotation,
    make_method,
    rotation_limit_rad,
    run_method,
)
from fullturn.methods.registry import methods
from fullturn.normalize import normalized_clouds
from fullturn.pose.explain import explain, pose_overlap
from fullturn.pose.search import find_finalists
from fullturn.pose.verdict import finalist_probabilities, limited, same_pose
from fullturn.result import Alternative, Registration, Symmetry
from fullturn.threads import torch_threads

if TYPE_CHECKING:
    from torch import Tensor

    from fullturn.pose.symmetry import CloudSymmetry

__all__ = ["RegistrationInterrupted", "methods", "register", "register_many"]


@torch_threads(1)
def register(
    source: Any,
    target: Any,
    *,
    method: str = "auto",
    seed: int = 0,
    source_viewpoint: Any = None,
    target_viewpoint: Any = None,
    max_rotation_deg: float | None = None,
) -> Registration:
    """Find the pose of `source` in the frame of `target`, with the probability that it is right.

    Each cloud is a file path, an (N, 3) array, list or tensor, an object with `.points` or
    `.vertices`, a mesh (sampled) or a `LoadedCloud`. Any unit will do, the same for both. A
    viewpoint (3,) says where the sensor stood, in the frame and unit of its cloud.
    `max_rotation_deg`, where it is known, is the largest rotation that can lie between the clouds
    as they come in: only poses whose R turns by no more (by 3° at most, as poses have errors) are
    looked for, and every angle up to it is taken as equally probable (180 is no limit). A
    translation isn't bounded by it.
    Where `load_cloud` drops missing returns, `matches` count the points that stayed.

    >>> rng = np.random.default_rng(0)
    >>> cloud = rng.normal(size=(200, 3)) * (1.0, 2.0, 3.0)
    >>> result = register(cloud, cloud + 5.0, method="icp-point")
    >>> result.T_target_source[:3, 3].round(3)
    array([5., 5., 5.])

    Raises:
        InputError: a cloud, viewpoint, seed, method name or largest rotation that cannot be used,
            or a method that takes no largest rotation.
        ReadError: a file that cannot be read.
        FullturnError: the method failed; what it raised is the cause.
    """
    begin = time.perf_counter()
    solver = make_method(method)
    rng = np.random.default_rng(whole_number(seed, "seed", least=0))
    max_rotation_deg = check_max_rotation(max_rotation_deg, type(solver))
    source_cloud, target_cloud = _load(source, "source"), _load(target, "target")
    source_eye = as_viewpoint(source_viewpoint, "source_viewpoint", frame="cloud's own")
    target_eye = as_viewpoint(target_viewpoint, "target_viewpoint", frame="cloud's own")
    checked = time.perf_counter()

    source_seen, target_seen, frame = normalized_clouds(
        source_cloud.points, target_cloud.points, source_eye, target_eye
    )
    normalized = time.perf_counter()

    estimate = run_method(
        solver, source_seen, target_seen, rng=rng, max_rotation_deg=max_rotation_deg
    )
    estimated = time.perf_counter()

    stated = estimate.success_probability
    doubts: tuple[str, ...] = ()
    if stated is None:
        limit = rotation_limit_rad(max_rotation_deg)
        stated, doubts = _judged(
            source_seen, target_seen, estimate.T_target_source, max_rotation_rad=limit
        )
    probabilities = [float(p) for p in stated]
    judged = time.perf_counter()

    T_best, *T_others = estimate.T_target_source
    explanation = explain(source_seen, target_seen, T_best)
    alternatives = tuple(
        Alternative(
            T_target_source=frame.denormalize(T.numpy(force=True)),
            success_probability=probability,
            overlap=pose_overlap(source_seen, target_seen, T),
        )
        for T, probability in zip(T_others, probabilities[1:], strict=True)
    )
    end = time.perf_counter()
    stages = dict(estimate.seconds) or {"estimate": estimated - normalized}
    return Registration(
        T_target_source=frame.denormalize(T_best.numpy(force=True)),
        success_probability=probabilities[0],
        overlap=explanation.overlap,
        alternatives=alternatives,
        symmetry=_symmetry(estimate.symmetry),
        matches=explanation.matches,
        match_weights=explanation.match_weights,
        covariance=frame.denormalize_covariance(explanation.covariance),
        seconds={
            "check": checked - begin,
            "normalize": normalized - checked,
            **stages,
            **({"judge": judged - estimated} if estimate.success_probability is None else {}),
            "explain": end - judged,
            "total": end - begin,
        },
        method=solver.name,
        notes=(*source_cloud.notes, *target_cloud.notes, *frame.notes, *estimate.notes, *doubts),
    )


def _load(thing: Any, role: str) -> LoadedCloud:
    return load_cloud(thing, name=None if isinstance(thing, LoadedCloud) else role)


def _judged(
    source: Cloud, target: Cloud, T_target_source: Tensor, *, max_rotation_rad: float | None
) -> tuple[Tensor, tuple[str, ...]]:
    """The verdict on poses (k, 4, 4) of a method that states no probabilities, and notes.

    It is asked about them among those that the default search finds: whether a pose is right shows
    only beside its rivals.
    """
    T = T_target_source
    found = find_finalists(source, target, given=T, max_rotation_rad=max_rotation_rad)
    rivals = ~same_pose(found.T_target_source.to(T), T).any(1)
    rivals[: len(T)] = True
    # The method's own order stays: its best pose is its answer, whatever the verdict thinks.
    stated = finalist_probabilities(
        found.T_target_source[rivals], found.features[rivals], max_rotation_rad=max_rotation_rad
    )[: len(T)]
    return limited(stated, source, target)


def _symmetry(found: CloudSymmetry | None) -> Symmetry | None:
    if found is None:
        return None
    axis = np.asarray(found.axis, dtype=np.float64)
    kind = f"{found.order}-fold" if found.order else "continuous"
    where = ", ".join(f"{round(x, 2) + 0.0:.2f}" for x in axis)  # no −0.00
    return Symmetry(axis, int(found.order), f"{kind} rotation about ({where})")
