from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fullturn.geometry.motion import invert, move, rigid


def test_inverses_undo_the_motions() -> None:
    rng = np.random.default_rng(0)
    R = Rotation.random(3, random_state=0).as_matrix()
    T = np.stack([rigid(turn, rng.normal(size=3)) for turn in R])
    points = rng.normal(size=(7, 3))
    for motion, inverse in zip(T, invert(T), strict=True):
        assert np.allclose(move(inverse, move(motion, points)), points)
        assert np.allclose(inverse, np.linalg.inv(motion))
        assert np.array_equal(inverse, invert(motion))
