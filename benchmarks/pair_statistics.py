"""What the pairs of a protocol are like: overlap and angle, without the noise.

    python benchmarks/pair_statistics.py SHAPES COUNT PROTOCOL [PROTOCOL…]

docs/protocols.md says how overlap is counted, and holds the figures.
"""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
from scipy.spatial import cKDTree

from fullturn.data.draw import ProtocolPairs
from fullturn.data.open import open_shapes
from fullturn.data.overlap import scan_overlap
from fullturn.data.pair import Pair
from fullturn.data.protocols import PROTOCOLS, Protocol
from fullturn.evaluation.metrics import rotation_error_deg
from fullturn.geometry.motion import move


def counted(protocol: Protocol) -> Protocol:
    """The protocol without noise and, for plane crops, with all points of the crop kept."""
    points = protocol.cloud_points
    if protocol.crop == "plane":
        points = int(protocol.kept_share * protocol.sample_points)
    return dataclasses.replace(protocol, noise_sigma=0.0, cloud_points=points)


def overlap(pair: Pair, protocol: Protocol) -> float:
    """The share of the source that the target has, too: exact copies where there are any."""
    moved = move(pair.T_target_source, pair.source)
    if protocol.resampled and protocol.crop != "plane":
        return scan_overlap(moved, pair.target)
    return float(np.mean(cKDTree(pair.target).query(moved)[0] < 1e-9))


def main() -> None:
    """Print one line a protocol."""
    if len(sys.argv) < 4 or not sys.argv[2].isdecimal():
        raise SystemExit("usage: pair_statistics.py SHAPES COUNT PROTOCOL [PROTOCOL…]")
    spec, count, *names = sys.argv[1:]
    shapes = open_shapes(spec)
    for name in names:
        protocol = counted(PROTOCOLS[name])
        pairs = list(ProtocolPairs(protocol, shapes, count=int(count)))
        shares = [overlap(pair, protocol) for pair in pairs]
        angles = [float(rotation_error_deg(pair.T_target_source, np.eye(4))) for pair in pairs]
        error = np.std(shares) / len(shares) ** 0.5
        print(
            f"{name}: overlap {np.mean(shares):.3f} ± {error:.3f}, least {min(shares):.3f}; "
            f"angle {np.mean(angles):.1f}°, at most {max(angles):.1f}°"
        )


if __name__ == "__main__":
    main()
