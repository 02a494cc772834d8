"""A made-up registration result for clouds of any kind."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fullturn.result import Alternative, Registration, Symmetry

Maker = Callable[..., tuple[np.ndarray, np.ndarray, Registration]]


def rigid(rotation_vector: tuple[float, float, float], t: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rotation_vector).as_matrix()
    T[:3, 3] = t
    return T


SHAPES = {
    "blob": lambda rng, n: rng.normal(size=(n, 3)) * (1.0, 2.0, 0.5),
    "planar": lambda rng, n: rng.normal(size=(n, 3)) * (1.0, 1.0, 0.0),
    "collinear": lambda rng, n: rng.normal(size=(n, 1)) * np.array([[1.0, 2.0, 3.0]]),
    "duplicate": lambda rng, n: rng.normal(size=(4, 3))[rng.integers(0, 4, n)],
    "one point": lambda rng, n: np.ones((n, 3)),
    "far away": lambda rng, n: rng.normal(size=(n, 3)) + 1e6,
    "millimeters": lambda rng, n: rng.normal(size=(n, 3)) * 1e-3,
    "kilometers": lambda rng, n: rng.normal(size=(n, 3)) * 1e5,
}


@pytest.fixture(params=SHAPES)
def shape(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def make_pair() -> Maker:
    def make(
        shape: str = "blob", count: int = 300, alternatives: int = 2, matches: int = 100
    ) -> tuple[np.ndarray, np.ndarray, Registration]:
        rng = np.random.default_rng(1)
        source = SHAPES[shape](rng, count)
        center = source.mean(axis=0)
        T = rigid((0.3, -1.2, 2.0), center * 0.0)
        T[:3, 3] = center - T[:3, :3] @ center
        target = source[: max(1, count * 4 // 5)] @ T[:3, :3].T + T[:3, 3]
        others = tuple(
            Alternative(rigid((0.0, 0.0, 1.0 + k), center) @ T, 0.1 / (k + 1), (0.3, 0.4))
            for k in range(alternatives)
        )
        chosen = rng.integers(0, len(target), matches)
        result = Registration(
            T_target_source=T,
            success_probability=0.8,
            overlap=(0.75, 0.8),
            alternatives=others,
            symmetry=Symmetry(np.array([0.0, 0.0, 1.0]), 2, "2-fold rotation about (0, 0, 1)"),
            matches=np.stack([chosen, chosen], axis=1),
            match_weights=rng.uniform(size=matches),
            covariance=np.diag([1e-4, 2e-4, 3e-4, 1e-6, 2e-6, 3e-6]),
            seconds={"describe": 0.2, "verify": 0.1, "total": 0.3},
            method="consensus",
            notes=("dropped 3 points",),
        )
        return source, target, result

    return make
