"""Register two arrays and move the source into the frame of the target."""

from __future__ import annotations

import numpy as np

import fullturn
from fullturn.data.procedural import dog
from fullturn.data.scan import scan_pair


def main() -> None:
    # Stand-ins for your own two arrays of shape (N, 3) and (M, 3).
    pair = scan_pair(dog(), np.random.default_rng(0), points=1024, min_overlap=0.4)
    source, target = pair.source, pair.target

    result = fullturn.register(source, target, seed=0)

    T = result.T_target_source
    moved = source @ T[:3, :3].T + T[:3, 3]
    print(np.round(T, 4))
    print(f"probability {result.success_probability:.3f}")
    print("overlap {:.0%} of the source, {:.0%} of the target".format(*result.overlap))
    print(f"{len(result.matches)} matches; the first point moves to {np.round(moved[0], 3)}")
    for other in result.alternatives:
        print(f"or, with probability {other.success_probability:.3f}, another pose")


if __name__ == "__main__":
    main()
