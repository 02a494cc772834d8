"""Register many pairs in parallel; a pair that fails stops none of the others."""

from __future__ import annotations

import numpy as np

import fullturn
from fullturn.data.procedural import dog
from fullturn.data.scan import scan_pair


def main() -> None:
    rng = np.random.default_rng(0)
    scans = [scan_pair(dog(), rng, points=512, min_overlap=0.4) for _ in range(2)]
    pairs = [(pair.source, pair.target) for pair in scans]
    pairs.append((np.zeros((5, 3)), scans[0].target))  # five times the same point: no pose

    outcomes = fullturn.register_many(pairs, seed=0, workers=2)

    for number, outcome in enumerate(outcomes):
        if isinstance(outcome, Exception):
            print(f"pair {number}: {outcome}")
        else:
            print(f"pair {number}: probability {outcome.success_probability:.3f}")


# Worker processes start by importing this file, so the work must not be at its top level.
if __name__ == "__main__":
    main()
