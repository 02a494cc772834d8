"""What a worker does: check that it has the same code, then register a few pairs."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import torch

import fullturn
from fullturn.api import register
from fullturn.batch import Outcome
from fullturn.cluster.pairs import PairRow
from fullturn.errors import FullturnError, InputError, one_line
from fullturn.methods.check import make_method
from fullturn.methods.fingerprint import REGISTER, fingerprint
from fullturn.methods.registry import get
from fullturn.workers import attempt

# Of a worker's threads, one imports a method's own file; no other may find it half run.
_FIRST = threading.Lock()


@dataclass(frozen=True)
class Job:
    """What all pairs of a run have in common."""

    folder: str  # where relative paths start
    method: str
    seed: int
    code: str  # the hash of the code of `register` and its method, and of the versions below
    version: str = fullturn.__version__
    versions: dict[str, str] = field(default_factory=dict)  # of the packages that they use


def make_job(folder: str, *, method: str, seed: int) -> Job:
    """The job with the code that this process has.

    Raises:
        InputError: no such method.
        DependencyError: the method's package is missing.
    """
    make_method(method)  # says now, and not once per pair, that a package is missing
    code, versions = _code_of(method)
    return Job(folder, method, seed, code, versions=versions)


def register_rows(rows: Sequence[PairRow], job: Job) -> list[dict[str, Any]]:
    """One row of results a pair, in the same order; a pair that fails becomes its reason.

    Raises:
        FullturnError: the method of this process isn't the one that the run was started with.
    """
    _check_code(job)
    # A process may register pairs in several threads; none of them may change the others' number.
    torch.set_num_threads(1)
    return [_result(row, job) for row in rows]


def failed_row(row: PairRow, reason: str) -> dict[str, Any]:
    """The row of a pair that has no result."""
    return {**_named(row), "status": "failed", "error": reason}


def _result(row: PairRow, job: Job) -> dict[str, Any]:
    begin, cpu_begin = time.perf_counter(), time.thread_time()
    found = _outcome(row, job)
    times = {
        "seconds": time.perf_counter() - begin,
        "cpu_seconds": time.thread_time() - cpu_begin,
    }
    if isinstance(found, FullturnError):
        return {**failed_row(row, one_line(found)), **times}
    symmetry = found.symmetry
    return {
        **_named(row),
        "status": "done",
        "T_target_source": found.T_target_source.ravel().tolist(),
        "success_probability": float(found.success_probability),
        "overlap_source": float(found.overlap[0]),
        "overlap_target": float(found.overlap[1]),
        "alternatives": len(found.alternatives),
        "alternative_T_target_source": [
            other.T_target_source.ravel().tolist() for other in found.alternatives
        ],
        "alternative_success_probability": [
            float(other.success_probability) for other in found.alternatives
        ],
        "symmetry": None if symmetry is None else symmetry.description,
        "symmetry_order": None if symmetry is None else symmetry.order,
        "symmetry_axis": None if symmetry is None else symmetry.axis.tolist(),
        "covariance": found.covariance.ravel().tolist(),
        "method": found.method,
        "notes": list(found.notes),
        **times,
    }


def _outcome(row: PairRow, job: Job) -> Outcome:
    source, target = (os.path.join(job.folder, path) for path in (row.source, row.target))
    return attempt(
        register,
        source,
        target,
        method=job.method,
        seed=job.seed,
        source_viewpoint=row.source_viewpoint,
        target_viewpoint=row.target_viewpoint,
        max_rotation_deg=row.max_rotation_deg,
    )


def _named(row: PairRow) -> dict[str, Any]:
    return {"id": row.id, "source": row.source, "target": row.target}


def _check_code(job: Job) -> None:
    """Refuse to answer with other code than the other workers' and the client's."""
    if job.version != fullturn.__version__:
        raise InputError(
            f"expected fullturn {job.version} on every worker, one has {fullturn.__version__}; "
            "install the same version everywhere"
        )
    with _FIRST:
        code, versions = _code_here(job.method)
    if code == job.code:
        return
    names = sorted(job.versions.keys() | versions.keys())
    differing = [
        f"{name} {versions.get(name, 'missing')} instead of {job.versions.get(name, 'missing')}"
        for name in names
        if versions.get(name) != job.versions.get(name)
    ]
    raise InputError(
        f"expected the same code of method {job.method} on every worker, one has "
        f"{', '.join(differing) or 'other files'}; install the same everywhere and restart it"
    )


@cache
def _code_here(method: str) -> tuple[str, dict[str, str]]:
    return _code_of(method)


def _code_of(method: str) -> tuple[str, dict[str, str]]:
    return fingerprint(get(method), roots=REGISTER)
