"""GMCNet as a method: files read strictly, the same pose as the network, matches for the search."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from fullturn import register
from fullturn.data.draw import ProtocolPairs
from fullturn.data.protocols import PROTOCOLS
from fullturn.data.shapes import ProceduralShapes
from fullturn.errors import InputError, ReadError
from fullturn.evaluation.metrics import pose_success
from fullturn.methods.fingerprint import fingerprint
from fullturn.methods.learned.gmcnet import GMCNet
from fullturn.methods.learned.weights import load_gmcnet
from fullturn.methods.registry import get
from fullturn.nn.clouds import CloudBatch
from fullturn.nn.config import GMCNetConfig
from fullturn.normalize import normalized_clouds

TABLE: dict[str, Any] = {
    "features": "ppf", "rif_only": True, "orientation": "centroid",
    "neighbors": [12, 12, 12], "channels": [32, 32, 16, 4],
}  # fmt: skip


def network() -> GMCNet:
    """An untrained network, the same at every call: even its descriptors say something."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        fields = {k: tuple(v) if isinstance(v, list) else v for k, v in TABLE.items()}
        return GMCNet(GMCNetConfig(**fields)).eval()


def write(path: Path, table: dict[str, Any] | None = None, **changes: Any) -> Path:
    tensors = {**network().state_dict(), **changes}
    save_file(
        {name: value for name, value in tensors.items() if value is not None},
        path,
        metadata={"gmcnet": json.dumps(TABLE if table is None else table)},
    )
    return path


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("weights") / "mine.safetensors")


@pytest.fixture(scope="module")
def clouds() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    shapes = ProceduralShapes(8, seed=3)
    pair = ProtocolPairs(PROTOCOLS["modelnet40/clean/180"], shapes, count=4, seed=2).pair(2)
    return pair.source, pair.target, pair.T_target_source


def test_what_was_written_comes_back(weights: Path) -> None:
    read = load_gmcnet(weights).state_dict()
    for name, value in network().state_dict().items():
        torch.testing.assert_close(read[name], value, rtol=0, atol=0)


def test_the_one_shot_pose_is_the_networks(weights: Path, clouds: tuple[np.ndarray, ...]) -> None:
    source, target, _ = clouds
    method = get(f"gmcnet@{weights}")()
    seen_source, seen_target, _ = normalized_clouds(source, target)
    found = method.estimate(seen_source, seen_target, rng=np.random.default_rng(0))
    with torch.no_grad():
        expected = network()(
            *(CloudBatch.collate([cloud.points.float()]) for cloud in (seen_source, seen_target))
        )
    torch.testing.assert_close(
        found.T_target_source.float(), expected.T_target_source, atol=1e-5, rtol=0
    )
    assert found.success_probability is None
    result = register(source, target, method=f"gmcnet@{weights}")
    assert result.method == f"gmcnet@{weights}"


def test_its_descriptors_lead_the_search(weights: Path, clouds: tuple[np.ndarray, ...]) -> None:
    source, target, T_true = clouds
    result = register(source, target, method=f"gmcnet@{weights}+consensus")
    assert pose_success(result.T_target_source, T_true, source)
    # They are asked, not the handcrafted ones: scores that say nothing find nothing.
    method = get(f"gmcnet@{weights}+consensus")()
    method.network.score = lambda a, b, x, y: torch.zeros(1, a.mask.shape[1], b.mask.shape[1])
    seen_source, seen_target, frame = normalized_clouds(source, target)
    blind = method.estimate(seen_source, seen_target, rng=np.random.default_rng(0))
    T = frame.denormalize(blind.T_target_source[0].numpy())
    assert not pose_success(T, T_true, source)


def test_large_clouds_are_thinned(weights: Path) -> None:
    cloud = np.random.default_rng(0).normal(size=(30_000, 3)) * (1.0, 0.7, 0.4)
    result = register(cloud, cloud + 1.0, method=f"gmcnet@{weights}")
    assert np.isfinite(result.T_target_source).all()


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("gmcnet@nowhere", "nowhere"),
        ("gmcnet@nowhere.safetensors+consensus", "nowhere.safetensors"),
        ("gmcnets", r"gmcnet\[@WEIGHTS\]"),
        ("gmcnet+icp", r"gmcnet\[@WEIGHTS\]"),
    ],
)
def test_unknown_names_are_told(name: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        get(name)


@pytest.mark.parametrize(
    ("table", "changes"),
    [
        ({**TABLE, "channels": [32, 32, 16, 8]}, {}),
        ({**TABLE, "unheard_of": 1}, {}),
        ({**TABLE, "features": "color"}, {}),
        (None, {"energy.fuse.weight": None}),
        (None, {"one.more": torch.zeros(2)}),
    ],
)
def test_weights_that_do_not_fit_are_an_error(
    tmp_path: Path, table: dict[str, Any] | None, changes: dict[str, Any]
) -> None:
    path = write(tmp_path / "other.safetensors", table, **changes)
    with pytest.raises(ReadError, match=r"other\.safetensors"):
        get(f"gmcnet@{path}")()


def test_a_damaged_file_is_an_error(tmp_path: Path, weights: Path) -> None:
    path = tmp_path / "cut.safetensors"
    path.write_bytes(weights.read_bytes()[:5000])
    with pytest.raises(ReadError, match=r"cut\.safetensors"):
        get(f"gmcnet@{path}")()
    save_file({"a": torch.zeros(1)}, path)
    with pytest.raises(ReadError, match="fullturn train"):
        get(f"gmcnet@{path}")()


def test_other_weights_are_another_method(tmp_path: Path, weights: Path) -> None:
    other = write(
        tmp_path / "mine.safetensors", **{"energy.fuse.weight": torch.zeros(128, 84).clone()}
    )
    names = (f"gmcnet@{weights}", f"gmcnet@{other}", f"gmcnet@{weights}+consensus")
    assert len({fingerprint(get(name))[0] for name in names}) == 3
    assert get(names[0]).settings()["weights"] == "mine.safetensors"
    assert get(names[0]) is get(names[0])
