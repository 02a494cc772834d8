"""The benchmark scripts on small data, with methods that know the answer or refuse."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import fullturn
from fullturn.data.motion import invert, move, rigid, uniform_rotation
from fullturn.data.pair import Pair
from fullturn.data.procedural import demo_object, sample_surface
from fullturn.errors import InputError

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import common
import modelnet
import real_scans
import speed


def truth(pair: Pair, seed: int) -> common.Answer:
    return common.Answer(pair.T_target_source, 0.9, (np.eye(4),), {"total": 0.1})


def identity(pair: Pair, seed: int) -> common.Answer:
    return common.Answer(np.eye(4))


@pytest.fixture
def data(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    points = [sample_surface(demo_object(), 4096, rng) for _ in range(2)]
    np.savez(
        tmp_path / "modelnet40_subset.npz",
        points=np.round(np.array(points) * 30000).astype(np.int16),
        scale=np.int64(30000),
        name=np.array(["pot_1", "pot_2"]),
        cls=np.array(["pot", "pot"]),
        use=np.array(["dev_eval", "dev_eval"]),
    )
    folder = tmp_path / "stanford_scans" / "pot"
    folder.mkdir(parents=True)
    poses = {}
    for name in ("a.ply", "b.ply"):
        T_world_scan = rigid(uniform_rotation(rng), rng.normal(size=3))
        cloud = move(invert(T_world_scan), points[0]).astype("<f4")
        header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(cloud)}\nend_header\n"
        (folder / name).write_bytes(header.encode() + cloud.tobytes())
        poses[name] = T_world_scan.tolist()
    (folder / "poses.json").write_text(json.dumps(poses))
    (folder / "pairs.csv").write_text(
        "source,target,overlap_min,relative_angle_deg\n"
        "a.ply,b.ply,0.7,30\nb.ply,a.ply,0.2,30\na.ply,b.ply,0.05,30\n"
    )
    return tmp_path


def arguments(out: Path, **more: object) -> argparse.Namespace:
    common_ones = {"count": 2, "seed": 0, "workers": 1, "out": out, "name": "run"}
    return argparse.Namespace(**common_ones, **more)


def test_modelnet_writes_rows_and_tables(data: Path, tmp_path: Path) -> None:
    names = ["modelnet40/noisy/180", "geotransformer/180"]
    modelnet.run(truth, "truth", arguments(tmp_path / "out", protocol=names, use="dev_eval"), data)
    report = json.loads((tmp_path / "out" / "run.json").read_text())
    assert list(report["sets"]) == names
    summary = report["sets"][names[0]]["summary"]
    assert summary["n"] == 2
    assert summary["recall_5deg"] == summary["success"] == summary["geometric_success"] == 1.0
    assert summary["calibration_error"] == pytest.approx(0.1)
    assert len(report["sets"][names[1]]["pairs"]) == 2
    assert "| geotransformer/180 | 2 |" in (tmp_path / "out" / "run.md").read_text()


def test_real_scans_know_their_truth_and_classes(data: Path, tmp_path: Path) -> None:
    scans = real_scans.load_pairs(data / "stanford_scans", seed=0)
    assert [real_scans.overlap_class(scan.overlap) for scan in scans] == [
        "0.6 and more",
        "0.1 to 0.3",
    ]
    for scan in scans:
        moved = move(scan.pair.T_target_source, scan.pair.source)
        assert np.allclose(moved, scan.pair.target, atol=1e-5)
    real_scans.run(identity, "identity", arguments(tmp_path / "out"), data)
    report = json.loads((tmp_path / "out" / "run.json").read_text())
    assert report["summaries"]["overlap 0.3 and more"]["n"] == 1
    assert report["summaries"]["overlap 0.1 to 0.3"]["success"] == 0.0
    assert "calibration_error" not in report["summaries"]["overlap 0.1 to 0.3"]


def test_refusals_are_failures_not_gaps(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **options: object) -> None:
        raise InputError("no")

    monkeypatch.setattr(fullturn, "register", refuse, raising=False)
    pair = speed.make_pair(100, seed=0)
    row = common.run_one(common.fullturn_registrar("icp-point"), pair, 0)
    assert row["error"] == "InputError: no"
    assert not row["success"]
    summary = common.summarize([row], seed=0)
    assert summary["errors"] == summary["n"] == 1


def test_an_unknown_method_is_an_error_before_any_pair() -> None:
    with pytest.raises(InputError, match="no-such-method"):
        common.fullturn_registrar("no-such-method")


def test_answers_hold_what_register_returns(monkeypatch: pytest.MonkeyPatch) -> None:
    pair = speed.make_pair(100, seed=0)
    asked = {}

    def register(source: np.ndarray, target: np.ndarray, **options: object) -> SimpleNamespace:
        asked.update(options)
        return SimpleNamespace(
            T_target_source=np.eye(4),
            success_probability=0.4,
            alternatives=(SimpleNamespace(T_target_source=pair.T_target_source),),
            seconds={"total": 1.0},
        )

    monkeypatch.setattr(fullturn, "register", register, raising=False)
    row = common.run_one(common.fullturn_registrar("icp-point"), pair, 7)
    assert asked == {"method": "icp-point", "seed": 7}
    assert row["any_success"]
    assert not row["success"]
    assert row["success_probability"] == 0.4


def test_speed_pairs_are_exact_and_its_table_shows_growth(tmp_path: Path) -> None:
    pair = speed.make_pair(500, seed=1)
    assert pair.source.shape == pair.target.shape == (500, 3)
    row = {
        "points": 1000, "repetitions": 1, "cpu_seconds": 0.1, "peak_mib": 300.0,
        "peak_mib_before": 200.0, "stages": {"match": 0.05}, "rotation_error_deg": 0.1,
        "error": None,
    }  # fmt: skip
    rows = [row, {**row, "points": 10_000, "cpu_seconds": 1.0}]
    speed.report(rows, method="m", seed=0, out=tmp_path, name="speed")
    text = (tmp_path / "speed.md").read_text()
    assert "n^1.00" in text
    assert "| match | 0.0500 | 0.0500 |" in text


def test_open3d_finds_an_easy_pose() -> None:
    pytest.importorskip("open3d")
    import open3d_baseline

    pair = speed.make_pair(700, seed=0)
    assert common.run_one(open3d_baseline.Open3dRegistrar(), pair, 0)["success"]
