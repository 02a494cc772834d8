"""Predict: what one method answers to one pair, and what that cost."""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from fullturn.data.pair import Pair
from fullturn.errors import FullturnError, one_line
from fullturn.methods.base import Method
from fullturn.methods.check import make_method, run_method
from fullturn.normalize import normalized_clouds
from fullturn.threads import torch_threads
from fullturn.workers import attempt


@dataclass(frozen=True, eq=False)
class Prediction:
    """A method's answer to a pair; the identity where it failed, and `error` then says why."""

    T_target_source: Float[np.ndarray, "4 4"]
    success_probability: float | None = None  # None: the method states none
    alternatives: tuple[Float[np.ndarray, "4 4"], ...] = ()
    error: str | None = None
    cpu_seconds: float = 0.0  # of the estimate alone
    wall_seconds: float = 0.0


@dataclass
class Predictor:
    """Answers pairs with methods that it makes once; made to live in a worker process.

    The first pair of each method is answered twice, so that imports and other first-call work are
    in no pair's time.
    """

    seed: int = 0
    _methods: dict[str, Method] = field(default_factory=dict, init=False)

    def __call__(self, task: tuple[str, Pair]) -> Prediction:
        method, pair = task
        if method not in self._methods:
            self._methods[method] = make_method(method)
            predict(self._methods[method], pair, seed=self.seed)
        return predict(self._methods[method], pair, seed=self.seed)


@torch_threads(1)
def predict(method: Method, pair: Pair, *, seed: int) -> Prediction:
    """The pose that ``fullturn.register`` returns for this pair, without its explanation.

    A method that takes the largest rotation is told it, where the pair knows one. Whatever the
    method raises is a failure of this pair, as is an answer that is none.
    """
    source, target, frame = normalized_clouds(
        pair.source, pair.target, pair.source_viewpoint, pair.target_viewpoint
    )
    cpu, wall = time.process_time(), time.perf_counter()
    # A method is a guest: nothing that it raises may stop the others.
    estimate = attempt(
        run_method,
        method,
        source,
        target,
        rng=np.random.default_rng(seed),
        max_rotation_deg=pair.max_rotation_deg,
    )
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    if isinstance(estimate, FullturnError):
        return Prediction(np.eye(4), error=one_line(estimate), cpu_seconds=cpu, wall_seconds=wall)
    T, *others = (frame.denormalize(pose.numpy(force=True)) for pose in estimate.T_target_source)
    stated = estimate.success_probability
    probability = None if stated is None else float(stated[0])
    return Prediction(T, probability, tuple(others), None, cpu, wall)


def pair_hash(pair: Pair) -> str:
    """A hash of all that a method sees of a pair: its clouds, and what is known of the pose."""
    digest = hashlib.sha256()
    limit_deg = pair.max_rotation_deg
    seen = {
        "source": pair.source,
        "target": pair.target,
        "source viewpoint": pair.source_viewpoint,
        "target viewpoint": pair.target_viewpoint,
        "max rotation": None if limit_deg is None else np.array(limit_deg),
    }
    for name, points in seen.items():
        if points is None:
            continue
        digest.update(name.encode())
        digest.update(str(points.shape).encode())
        digest.update(points.astype("<f8").tobytes())
    return digest.hexdigest()
