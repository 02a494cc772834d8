"""`fullturn scan` writes clouds that its poses put back on the mesh, and says what it left out."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
import typer
from typer.testing import CliRunner

from fullturn.cli.scan import scan
from fullturn.errors import InputError, ReadError, WriteError
from fullturn.io import load_cloud

QUICK = ["--views", "3", "--width", "40"]


@pytest.fixture
def run():
    app = typer.Typer()
    app.command()(scan)

    def call(*arguments: object):
        return CliRunner().invoke(app, [*map(str, arguments)], catch_exceptions=False)

    return call


@pytest.fixture(params=[".ply", ".stl"])
def cube(request, tmp_path) -> Path:
    path = tmp_path / f"cube{request.param}"
    trimesh.creation.box(extents=(2, 2, 2)).export(path)
    return path


@pytest.fixture
def no_matplotlib(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)


def views_of(out: Path) -> list[dict]:
    return json.loads((out / "poses.json").read_text(encoding="utf-8"))["views"]


def in_object(out: Path, view: dict) -> np.ndarray:
    T = np.array(view["T_object_camera"])
    return load_cloud(out / f"{view['name']}.ply").points @ T[:3, :3].T + T[:3, 3]


def test_the_poses_put_all_views_back_on_the_mesh(run, cube, tmp_path):
    pytest.importorskip("matplotlib")
    out = tmp_path / "new" / "folder"
    done = run(cube, "--out", out, "--points", 300, "--seed", 4, *QUICK)
    assert done.exit_code == 0
    clouds = {f"view_{number:02d}.ply" for number in range(3)}
    assert {path.name for path in out.iterdir()} == {*clouds, "poses.json", "contact_sheet.png"}
    for view in views_of(out):
        points = in_object(out, view)
        assert len(points) == view["points"] == 300
        np.testing.assert_allclose(np.abs(points).max(axis=1), 1.0, atol=1e-9)
        eye = np.array(view["viewpoint"])
        assert np.linalg.norm(eye) == pytest.approx(3 * np.sqrt(3))
        np.testing.assert_allclose(np.array(view["T_object_camera"])[:3, 3], eye)


def test_poses_say_how_the_views_were_made(run, cube, tmp_path, no_matplotlib):
    options = ["--noise", 0.001, "--quantize", 0.002, "--grazing", 15, "--flying", 0.25]
    run(cube, "--out", tmp_path / "out", *options, "--holes", 2, "--distance", 2.5, *QUICK)
    told = json.loads((tmp_path / "out" / "poses.json").read_text(encoding="utf-8"))
    assert told["mesh"] == cube.name
    assert (told["seed"], told["distance"], told["plane"]) == (0, 2.5, False)
    sensor = told["sensor"]
    assert (sensor["noise"], sensor["quantize"], sensor["holes"]) == (0.001, 0.002, 2)
    assert (sensor["grazing_deg"], sensor["flying"]) == (15.0, 0.25)
    for view in told["views"]:
        assert (view["width"], view["height"], view["plane_points"]) == (40, 40, 0)
        # The shorter side holds the ball: 20 pixels at tan(asin(1/2.5)).
        assert view["focal"] == pytest.approx(20 / np.tan(np.arcsin(1 / 2.5)))


def test_points_of_the_plane_are_the_last_rows(run, cube, tmp_path, no_matplotlib):
    run(cube, "--out", tmp_path / "out", "--plane", "--points", 0, *QUICK)
    for view in views_of(tmp_path / "out"):
        points = in_object(tmp_path / "out", view)
        of_plane = points[len(points) - view["plane_points"] :]
        assert 0 < len(of_plane) < len(points)
        np.testing.assert_allclose(of_plane[:, 2], -1.0, atol=1e-9)


def test_without_matplotlib_only_the_picture_is_missing(run, cube, tmp_path, no_matplotlib):
    done = run(cube, "--out", tmp_path / "out", *QUICK)
    assert done.exit_code == 0
    assert "fullturn[viz]" in done.output
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"view_00.ply", "view_01.ply", "view_02.ply", "poses.json"}


def test_the_same_seed_gives_the_same_bytes(run, cube, tmp_path):
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        run(cube, "--out", tmp_path / name, "--seed", seed, "--noise", 0.001, *QUICK)
    for file in (tmp_path / "a").iterdir():
        content = file.read_bytes()
        assert (tmp_path / "b" / file.name).read_bytes() == content
        assert (tmp_path / "c" / file.name).read_bytes() != content


def test_views_that_see_nothing_are_told(run, cube, tmp_path):
    done = run(cube, "--out", tmp_path / "out", "--quantize", 100, *QUICK)
    assert done.exit_code == 0
    assert "3 of 3 views see nothing" in done.output
    assert "view_00, view_01, view_02" in done.output
    assert [view["points"] for view in views_of(tmp_path / "out")] == [0, 0, 0]
    assert not list((tmp_path / "out").glob("*.ply"))


def test_an_earlier_runs_clouds_are_removed(run, cube, tmp_path, no_matplotlib):
    out = tmp_path / "out"
    run(cube, "--out", out, "--views", 8, "--width", 40)
    kept = ["view_08.ply", "view_03.txt", "view_03_clean.ply", "mine.ply"]
    for name in kept:
        (out / name).write_text("mine")
    done = run(cube, "--out", out, *QUICK)
    names = [f"view_{number:02d}.ply" for number in range(8)]
    assert f"that only an earlier run wrote: {', '.join(names[3:])}\n" in done.output
    expected = {*names[:3], *kept, "poses.json"}
    assert {path.name for path in out.iterdir()} == expected
    assert "removed" not in run(cube, "--out", out, *QUICK).output
    # Views that now see nothing leave no cloud either.
    blind = run(cube, "--out", out, "--quantize", 100, *QUICK)
    assert f"that only an earlier run wrote: {', '.join(names[:3])}\n" in blind.output
    assert {path.name for path in out.iterdir()} == {*kept, "poses.json"}


@pytest.mark.parametrize(
    "content",
    [
        b"\xff",
        b"no JSON",
        b"[1]",
        b"{}",
        b'{"views": 3}',
        b'{"views": [3]}',
        b'{"views": [{"name": ["view_05"]}]}',
        b'{"views": [{"name": 5}, {"name": "../view_05"}, {"name": "mine"}, {"name": "view_5"}]}',
    ],
)
def test_nothing_that_lies_there_is_touched(run, cube, tmp_path, no_matplotlib, content):
    out = tmp_path / "out"
    out.mkdir()
    (out / "view_05.ply").write_text("mine")
    (out / "poses.json").write_bytes(content)
    with pytest.raises(WriteError, match=r"found poses\.json, which no earlier run"):
        run(cube, "--out", out, *QUICK)
    assert (out / "poses.json").read_bytes() == content
    (out / "poses.json").unlink()
    assert "removed" not in run(cube, "--out", out, *QUICK).output
    assert (out / "view_05.ply").read_text() == "mine"
    with pytest.raises(WriteError, match=r"found view_05\.ply, which no earlier run"):
        run(cube, "--out", out, "--views", 8, "--width", 40)
    assert (out / "view_05.ply").read_text() == "mine"


def test_what_is_no_mesh_is_named(run, tmp_path):
    out = tmp_path / "out"
    (tmp_path / "cloud.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nend_header\n0 0 0\n1 0 0\n0 1 0\n"
    )
    with pytest.raises(InputError, match=r"cloud\.ply: expected a mesh with triangles"):
        run(tmp_path / "cloud.ply", "--out", out)
    (tmp_path / "half.off").write_text("OFF\n3 1 0\n0 0 0\n")
    with pytest.raises(ReadError, match="the file ends before"):
        run(tmp_path / "half.off", "--out", out)
    with pytest.raises(ReadError, match="there is none"):
        run(tmp_path / "none.ply", "--out", out)
    with pytest.raises(ReadError, match="no suffix"):
        run(tmp_path, "--out", out)
    (tmp_path / "hole.obj").write_text("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match="1 with NaN"):
        run(tmp_path / "hole.obj", "--out", out)
    assert not out.exists()


def test_what_cannot_be_done_is_named(run, cube, tmp_path):
    with pytest.raises(InputError, match="more than 1 radius"):
        run(cube, "--out", tmp_path / "out", "--distance", "1")
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match="cannot make the folder"):
        run(cube, "--out", tmp_path / "file", *QUICK)


def test_it_writes_over_no_mesh(run, tmp_path):
    mesh = tmp_path / "view_01.ply"
    trimesh.creation.box(extents=(2, 2, 2)).export(mesh)
    content = mesh.read_bytes()
    with pytest.raises(WriteError, match="is an input"):
        run(mesh, "--out", tmp_path, *QUICK)
    assert mesh.read_bytes() == content


def test_an_interrupted_scan_leaves_no_poses_of_another(run, cube, tmp_path, no_matplotlib):
    from fullturn.io import save

    out = tmp_path / "views"
    assert run(cube, "--out", out, "--views", 5, "--width", 40).exit_code == 0

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(save, "save_cloud", interrupted)
        assert run(cube, "--out", out, *QUICK, "--seed", "1").exit_code != 0
    assert not (out / "poses.json").exists()
    # The next run knows the clouds that lie there.
    assert "view_03.ply, view_04.ply" in run(cube, "--out", out, *QUICK).output
    names = {path.name for path in out.iterdir()}
    assert names == {"view_00.ply", "view_01.ply", "view_02.ply", "poses.json"}
