"""Each scan against the rest of its group as one cloud."""

from __future__ import annotations

import numpy as np
import pytest
from fusion_cases import HALF_TURN, between, case, errors

from fullturn.fusion.connect import refine_groups
from fullturn.fusion.edges import Registrar
from fullturn.fusion.graph import GraphConfig, placement_at
from fullturn.fusion.recheck import recheck_scans
from fullturn.geometry.motion import invert


@pytest.mark.parametrize("turned", [None, 0, 4])
def test_a_scan_that_its_pairs_turned_is_turned_back(turned: int | None) -> None:
    scans, truth, _, edges = case(0.5, 0)
    poses = truth.copy()
    if turned is not None:
        poses[turned] = HALF_TURN @ poses[turned]
    placed = invert(poses[[0]]) @ poses
    config, group = GraphConfig(), list(range(len(scans)))
    placement = placement_at(edges, [group], placed, config)
    assert placement.groups == (tuple(group),)
    with Registrar(length=1.0, method="auto", seed=0, workers=1) as registrar:
        found, again, changed = recheck_scans(
            registrar, scans, 1.0, config, edges, placement, placed, progress=False
        )
    assert changed == (turned is not None)
    assert again.groups == placement.groups
    assert {edge.source for edge in found[len(edges) :]} == ({turned} - {None})
    unmoved = [scan for scan in group if scan != turned]
    np.testing.assert_array_equal(again.probability[unmoved], placement.probability[unmoved])
    if turned is not None:
        assert again.probability[turned] > 0.3
    refined, _ = refine_groups(scans, 1.0, found, again)
    for T in (again.T_group_scan, refined):
        for scan in group:
            angle, shift = errors(T[scan], between(truth, 0, scan))
            assert angle < 1.0
            assert shift < 0.02
