"""What is embedded in the report decodes to the clouds and poses that went in."""

from __future__ import annotations

import base64
import json

import numpy as np

from fullturn.geometry.motion import move
from fullturn.viz.payload import make_payload
from fullturn.viz.scene import make_scene


def decode(block: dict, unit: float) -> np.ndarray:
    """Points relative to their center, in the unit of the input."""
    steps = np.frombuffer(base64.b64decode(block["int16"]), dtype="<i2").reshape(-1, 3)
    return unit * block["step"] * steps


def payload_of(pair, **limits):
    source, target, result = pair
    scene = make_scene(
        source, target, result, max_points=200, max_alternatives=2, max_matches=50, **limits
    )
    return scene, make_payload(scene, result)


def test_points_survive_within_half_a_step(make_pair, shape):
    scene, payload = payload_of(make_pair(shape))
    for name, points in (("source", scene.source), ("target", scene.target)):
        block = payload[name]
        found = decode(block, payload["unit"]) + block["center"]
        half_step = 0.5 * payload["unit"] * block["step"]
        assert np.abs(found - points).max() <= half_step * 1.01 + 1e-15 * np.abs(points).max() * 8
        assert half_step < 1e-4 * max(np.ptp(points, axis=0).max(), payload["unit"])


def test_views_place_the_source_where_its_pose_does(make_pair, shape):
    pair = make_pair(shape)
    scene, payload = payload_of(pair)
    result = pair[2]
    unit = payload["unit"]
    target_center = np.array(payload["target"]["center"])
    origin = target_center - unit * np.array(payload["center"])
    poses = {1: result.T_target_source, 2: result.T_target_source}
    poses |= {3 + k: other.T_target_source for k, other in enumerate(result.alternatives)}
    centered = decode(payload["source"], unit)
    tolerance = 1e-4 * unit + 1e-9 * np.abs(scene.source).max()
    for number, T in poses.items():
        view = payload["views"][number]
        R = np.array(view["R"]).reshape(3, 3)
        found = origin + centered @ R.T + unit * np.array(view["t"])
        np.testing.assert_allclose(found, move(T, scene.source), atol=tolerance)


def test_the_aligned_pair_fills_the_unit_ball(make_pair, shape):
    _, payload = payload_of(make_pair(shape))
    moved = decode(payload["target"], 1.0) + payload["center"]
    reach = np.linalg.norm(moved, axis=1).max()
    assert reach < 4.0
    assert reach > 0.3 or shape == "one point"


def test_everything_is_finite_json(make_pair, shape):
    _, payload = payload_of(make_pair(shape))
    json.dumps(payload, allow_nan=False)


def test_distances_are_dark_at_the_partner_and_saturate(make_pair):
    scene, payload = payload_of(make_pair())
    near = np.frombuffer(base64.b64decode(payload["views"][1]["near"]["source"]), dtype="u1")
    distances = scene.distances[0].source
    expected = np.rint(255 * np.clip(distances / scene.far, 0, 1))
    np.testing.assert_array_equal(near, expected)
    assert (near == 0).sum() > 100


def test_no_matches_and_no_alternatives(make_pair):
    _, payload = payload_of(make_pair(alternatives=0, matches=0))
    assert [view["name"] for view in payload["views"]] == ["Before", "After", "Matches"]
    assert payload["matches"]["source"]["int16"] == ""
