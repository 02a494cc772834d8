from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

from fullturn.data.motion import uniform_rotation
from fullturn.data.procedural import demo_object
from fullturn.data.stanford import StanfordScans
from fullturn.data.surface import sample_surface
from fullturn.errors import InputError, ReadError
from fullturn.geometry.motion import invert, move, rigid
from fullturn.io import save_cloud

PAIRS = """source,target,overlap_min,relative_angle_deg
a.ply,b.ply,0.7,30
b.ply,a.ply,0.3,30
a.ply,c.ply,0.2,30
a.ply,b.ply,0.05,30
"""


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    """Two objects in millimeters; the three scans of each are the same points in other frames."""
    rng = np.random.default_rng(0)
    for name in ("pot", "jug"):
        points = 300.0 * sample_surface(demo_object(), 500, rng)
        poses = {}
        folder = tmp_path / "scans" / name
        folder.mkdir(parents=True)
        for file in ("a.ply", "b.ply", "c.ply"):
            T_world_scan = rigid(uniform_rotation(rng), 100.0 * rng.normal(size=3))
            save_cloud(folder / file, move(invert(T_world_scan), points))
            poses[file] = T_world_scan.tolist()
        (folder / "poses.json").write_text(json.dumps(poses))
        (folder / "pairs.csv").write_text(PAIRS)
    return tmp_path / "scans"


def test_pairs_groups_and_names_follow_the_list(scans: Path) -> None:
    pairs = StanfordScans(scans)
    assert len(pairs) == 6
    classes = ["overlap 0.6 and more", "overlap 0.3 to 0.6", "overlap 0.1 to 0.3"]
    assert [pairs.group(i) for i in range(6)] == classes * 2
    assert [pairs.pair(i).name for i in (0, 5)] == ["jug/a.ply-b.ply", "pot/a.ply-c.ply"]
    assert len(StanfordScans(scans, least_overlap=0.6)) == 2
    everything = StanfordScans(scans, least_overlap=0.0)
    assert everything.group(3) == "overlap below 0.1"


def test_the_truth_maps_source_to_target(scans: Path) -> None:
    for pair in StanfordScans(scans, seed=5):
        moved = move(pair.T_target_source, pair.source)
        assert np.allclose(moved, pair.target, atol=1e-8 * np.abs(pair.target).max() + 1e-8)
        # Neither cloud lies as it was scanned.
        R = pair.T_target_source[:3, :3]
        assert np.allclose(R @ R.T, np.eye(3), atol=1e-12)


def test_motions_depend_on_seed_and_number_alone(scans: Path) -> None:
    first, other = StanfordScans(scans, seed=1), StanfordScans(scans, seed=2)
    copy = pickle.loads(pickle.dumps(first))
    assert copy.pair(4).source.tobytes() == first.pair(4).source.tobytes()
    assert other.pair(4).source.tobytes() != first.pair(4).source.tobytes()


def test_the_description_follows_the_files(scans: Path) -> None:
    before = StanfordScans(scans).description
    assert before["objects"] == ["jug", "pot"]
    assert str(scans.parent) not in json.dumps(before)
    (scans / "pot" / "pairs.csv").write_text(PAIRS.replace("0.7", "0.8"))
    assert StanfordScans(scans).description["sha256"] != before["sha256"]


def test_other_folders_are_named(scans: Path, tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="expected folders with poses"):
        StanfordScans(tmp_path)
    with pytest.raises(InputError, match="lower least_overlap"):
        StanfordScans(scans, least_overlap=0.9)
    (scans / "pot" / "pairs.csv").write_text("source,target\na.ply,b.ply\n")
    with pytest.raises(ReadError, match="overlap_min"):
        StanfordScans(scans)
    (scans / "pot" / "pairs.csv").write_text("source,target,overlap_min\na.ply,x.ply,0.5\n")
    with pytest.raises(ReadError, match=r"the pair a\.ply, x\.ply"):
        StanfordScans(scans)
    for text, message in (
        ("[1, 2]", "JSON object"),
        ('{"a.ply": [[1]]}', "rigid 4×4 poses"),
        ("{}", "no scan"),
    ):
        (scans / "pot" / "poses.json").write_text(text)
        with pytest.raises(ReadError, match=message):
            StanfordScans(scans)
