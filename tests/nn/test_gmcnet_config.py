"""The configuration: the presets of the paper, and what cannot be built."""

from __future__ import annotations

from typing import Any

import pytest

from fullturn.errors import InputError
from fullturn.nn.config import PRESETS, GMCNetConfig


@pytest.mark.parametrize(
    ("name", "neighbors", "sampling", "channels", "temperature"),
    [
        ("clean", (5, 5, 5), (2, 4), (128, 128, 32, 8), "fixed"),
        ("noisy", (64, 64, 64), (2, 4), (128, 64, 32, 16), "predicted"),
        ("noisy-unseen", (64, 32, 16), (4, 16), (128, 128, 32, 8), "predicted"),
    ],
)
def test_presets(name: str, neighbors: Any, sampling: Any, channels: Any, temperature: str) -> None:
    preset = PRESETS[name]
    assert (preset.neighbors, preset.sampling) == (neighbors, sampling)
    assert (preset.channels, preset.temperature) == (channels, temperature)
    assert (preset.alpha, preset.beta, preset.sinkhorn_rounds) == (0.2, 1.0, 5)
    assert (preset.features, preset.rif_only, preset.matching) == ("ppf", False, "fused")
    assert preset.graph
    assert preset.tpt
    assert preset.hgm


@pytest.mark.parametrize(
    ("changes", "channels"),
    [
        ({}, 10),
        ({"features": "fpfh"}, 10),
        ({"features": "rri"}, 14),
        ({"rif_only": True}, 4),
        ({"rif_only": True, "features": "rri"}, 8),
    ],
)
def test_channels_of_a_relation(changes: dict[str, Any], channels: int) -> None:
    assert GMCNetConfig(**changes).relation_channels == channels


def test_ablations_change_what_is_built() -> None:
    assert GMCNetConfig(graph=False).graph_neighbors == (2, 2, 2)
    assert GMCNetConfig(neighbors=(9, 8, 7)).graph_neighbors == (9, 8, 7)
    assert GMCNetConfig(hgm=False).term_channels == (128, 128)
    assert GMCNetConfig().term_channels == (128, 128, 32, 8)


@pytest.mark.parametrize(
    ("changes", "messages"),
    [
        ({"features": "shot"}, ["features must be one of ppf, rri, fpfh, got 'shot'"]),
        ({"matching": "x", "temperature": "y"}, ["matching must be", "temperature must be"]),
        ({"neighbors": (5, 5)}, [r"neighbors must be 3 numbers of at least 1, got \(5, 5\)"]),
        ({"neighbors": (0, 5, 5)}, ["neighbors must be 3 numbers"]),
        ({"sampling": (4, 2)}, ["sampling must not get finer"]),
        ({"channels": (128, 120, 32, 8)}, ["must be multiples of 16"]),
        ({"features": "fpfh", "orientation": "none"}, ["fpfh needs oriented normals"]),
        ({"sinkhorn_rounds": 0}, ["sinkhorn_rounds must be at least 1, got 0"]),
    ],
)
def test_wrong_values_are_all_named(
    changes: dict[str, Any], messages: list[str], unchecked: None
) -> None:
    for message in messages:
        with pytest.raises(InputError, match=message):
            GMCNetConfig(**changes)
