"""`fullturn locate`: files, table, one JSON object, errors of one line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from fullturn.cli.main import build_app
from fullturn.data.camera import look_at
from fullturn.data.procedural import dog
from fullturn.data.raycast import Raycaster, back_project, to_object
from fullturn.io import load_cloud, read_transform, save_cloud


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A model and a scan of it, shifted by (5, 6, 7); three returns are missing."""
    folder = tmp_path_factory.mktemp("locate")
    model, scene = folder / "dog.stl", folder / "scene.xyz"
    dog().export(model)
    camera = look_at(np.array([2.0, 2.0, 1.0]), np.zeros(3), width=80, height=80)
    depth = Raycaster(dog(), backend="python").image(camera).depth
    points = to_object(back_project(depth, camera), camera) + np.array([5.0, 6.0, 7.0])
    np.savetxt(scene, np.vstack([points, np.full((3, 3), np.nan)]))
    return model, scene


def call(*arguments: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(build_app(), ["locate", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


def test_outputs_one_json_object_and_the_prepared_file(
    files: tuple[Path, Path], tmp_path: Path
) -> None:
    prepared, out, save = (tmp_path / name for name in ("p.safetensors", "T.json", "m.ply"))
    options = ["--prepared", prepared, "--viewpoint", "7,8,8", "--json"]
    code, text, _ = call(*files, *options, "--out", out, "--save", save)
    assert code == 0
    content = json.loads(text)
    T = np.array(content["T_scene_model"])
    np.testing.assert_allclose(T[:3, 3], (5, 6, 7), atol=0.03)
    np.testing.assert_allclose(T[:3, :3], np.eye(3), atol=0.03)
    assert content["surface_probability"] > 0.5
    assert any("dropped 3" in note for note in content["notes"])
    np.testing.assert_array_equal(read_transform(out), T)
    assert len(load_cloud(save).points) > 1000
    # The prepared file is read the second time, and is a model of its own.
    for model, told in ((files[0], options), (prepared, options[2:])):
        code, text, _ = call(model, files[1], *told)
        assert code == 0
        np.testing.assert_array_equal(json.loads(text)["T_scene_model"], T)
    code, _, err = call(files[1], files[1], *options)
    assert code == 1
    assert "from another" in err


def test_people_get_a_table_and_a_low_probability_exits_with_3(
    files: tuple[Path, Path], tmp_path: Path
) -> None:
    box = tmp_path / "box.ply"
    save_cloud(box, trimesh.sample.sample_surface(trimesh.creation.box(), 3000, seed=0)[0])
    code, out, err = call(box, files[1], "--min-probability", 0.9)
    assert code == 3
    assert "below" in err
    for word in ("model in scene", "probability", "translation", "outside", "seconds"):
        assert word in out


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["{model}", "none.ply"], 1, "there is none"),
        (["none.ply", "{scene}"], 1, "there is none"),
        (["{model}", "{scene}", "--out", "T.png"], 1, ".txt, .json"),
        (["{model}", "{scene}", "--prepared", "p.npz"], 1, ".safetensors"),
        (["m.safetensors", "{scene}", "--prepared", "p.safetensors"], 2, "prepared one itself"),
        (["{model}", "{scene}", "--viewpoint", "1,2"], 2, "three numbers"),
        (["{model}", "{scene}", "--min-probability", "nan"], 2, "min-probability"),
    ],
)
def test_known_errors_are_told(
    arguments: list[str], code: int, message: str, files: tuple[Path, Path]
) -> None:
    found, out, err = call(*(w.format(model=files[0], scene=files[1]) for w in arguments))
    assert (found, out) == (code, "")
    assert message in " ".join(err.replace("│", " ").split())
