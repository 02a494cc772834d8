"""Sensors as various as those that scans come from."""

from __future__ import annotations

import numpy as np

from fullturn.data.sensor import Sensor


def random_sensor(rng: np.random.Generator, *, distance: float) -> Sensor:
    """Of three sensors, one is ideal, one has noise alone, and one does all that a sensor does.

    In radii of an object that is `distance` radii away, the standard deviation of the noise is
    0.002 to 0.01 and a step of the depth 0.001 to 0.008. Returns are lost below 10° to 30°, up to
    0.3 of the pixels at edges fly, and up to three patches give nothing.
    """
    kind = rng.integers(3)
    if kind == 0:
        return Sensor()
    # Both grow with depth².
    noise, quantize = (rng.uniform(*at) / distance**2 for at in ((0.002, 0.01), (0.001, 0.008)))
    if kind == 1:
        return Sensor(noise=noise)
    return Sensor(
        noise=noise,
        quantize=quantize,
        grazing_deg=rng.uniform(10.0, 30.0),
        flying=rng.uniform(0.0, 0.3),
        holes=int(rng.integers(4)),
    )
