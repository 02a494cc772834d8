"""More than 2,000 random and degenerate inputs: each gives a result or a named, one-line error."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from contract_methods import METHODS
from contract_shapes import bracket

from fullturn import load_cloud, register
from fullturn.errors import FullturnError
from fullturn.io import LoadedCloud, save_cloud
from fullturn.methods.registry import names

ARRAYS, FILES_PER_KIND = 900, 80
DTYPES = ["f8", "f4", "f2", "i8", "i4", "u1", "?", "c16", "U5", "O", ">f8", "M8[s]"]
SPECIAL = [0.0, -0.0, 1.0, -1.0, 1e-320, 1e-200, 1e-8, 1e8, 1e154, 1e200, 1.8e308, -1e308]
KINDS = [
    *["ply", "ply-ascii", "ply-mesh", "ply-big", "pcd-ascii", "pcd-binary", "xyz", "csv"],
    *["npy", "npz", "obj", "stl", "stl_ascii", "off", "glb"],
]


def outcome(call: Callable[[], Any]) -> str:
    """The name of what came out; anything but a result or a good error fails the test."""
    try:
        call()
    except FullturnError as error:
        message = str(error)
        assert message.strip()
        assert "\n" not in message
        assert "\r" not in message
        assert len(message) < 1200
        return type(error).__name__
    return "result"


def random_array(rng: np.random.Generator) -> Any:
    """Points of odd shapes, types and values, few of them usable."""
    if rng.random() < 0.55:
        shapes = [(3,), (7, 2), (3, 9), (2, 5, 3), (0, 3), (5, 0), (), (4, 4), (1, 3), (2, 3)]
        shape = shapes[rng.integers(len(shapes))]
    else:
        shape = (int(rng.integers(3, 60)), 3)
    values = np.asarray(rng.normal(size=shape) * 10.0 ** rng.uniform(-12, 12))
    choice = rng.integers(8)
    if choice == 0:
        values = rng.choice(SPECIAL, size=shape)
    elif choice == 1:
        values = np.where(rng.random(shape) < 0.1, rng.choice([np.nan, np.inf, -np.inf]), values)
    elif choice == 2:
        values = np.round(values * 0 + rng.integers(0, 2, shape))
    elif choice == 3 and len(shape) == 2:
        values = values * (rng.random(shape[1]) < 0.5)
    elif choice == 4:
        values = values + 10.0 ** rng.uniform(-3, 12)
    values = np.asarray(values)
    if rng.random() < 0.25:
        with np.errstate(all="ignore"):
            values = np.asarray(np.nan_to_num(values)).astype(str(rng.choice(DTYPES)))
    forms: list[Callable[[Any], Any]] = [np.asarray, np.asfortranarray, lambda x: x.tolist()]
    if values.dtype.kind in "fiuc" and values.dtype.isnative:
        forms.append(lambda x: torch.from_numpy(np.array(x)))
    return forms[rng.integers(len(forms))](values)


def test_arrays_of_every_sort() -> None:
    rng = np.random.default_rng(0)
    good = bracket(60)
    came: Counter[str] = Counter()
    methods = [name for name in names() if name.startswith("icp")]
    for number in range(ARRAYS):
        clouds = [random_array(rng), good if rng.random() < 0.7 else random_array(rng)]
        if rng.random() < 0.5:
            clouds.reverse()
        method = methods[number % len(methods)]

        def call(clouds: list[Any] = clouds, method: str = method) -> Any:
            return register(*clouds, method=method)

        came[outcome(call)] += 1
    assert set(came) == {"result", "InputError"}
    assert min(came.values()) > ARRAYS // 12


@pytest.mark.parametrize("method", METHODS)
def test_degenerate_clouds_through_every_method(method: str) -> None:
    rng = np.random.default_rng(1)
    square = np.array([[x, y, 0.0] for x in range(7) for y in range(7)])
    clouds = [
        np.eye(3),
        np.vstack([np.eye(3), np.zeros(3)]),
        np.repeat(np.eye(3), 20, axis=0),
        square,
        square + rng.normal(size=square.shape) * 1e-9,
        np.vstack([np.zeros((500, 3)), np.eye(3)]),
        np.vstack([bracket(100), [[1e6, 0, 0]]]),
        bracket(100) * (1, 1, 1e-5),
        bracket(100) * 1e100,
        bracket(100) * 1e-100,
        bracket(50) + 1e9,
        rng.normal(size=(80, 3)),
        np.round(bracket(200) * 3),
        np.exp(rng.normal(size=(60, 3)) * 8),
    ]
    for i, source in enumerate(clouds):
        target = clouds[(i * 5 + 3) % len(clouds)]
        for pair in ((source, source), (source, target)):
            assert outcome(lambda pair=pair: register(*pair, method=method)) == "result"


def good_file(kind: str, folder: Path) -> Path:
    trimesh = pytest.importorskip("trimesh")
    points = bracket(40)
    path = folder / f"good.{kind.split('-')[0].removesuffix('_ascii')}"
    if kind in ("ply", "xyz", "csv", "npy"):
        save_cloud(path, points)
    elif kind == "npz":
        np.savez(path, points=points)
    elif kind == "ply-mesh":
        path.write_bytes(trimesh.creation.icosphere(subdivisions=1).export(file_type="ply"))
    elif kind.startswith("ply"):
        encoding = "ascii" if kind == "ply-ascii" else "binary_big_endian"
        axes = "".join(f"property double {axis}\n" for axis in "xyz")
        head = f"ply\nformat {encoding} 1.0\nelement vertex 40\n{axes}end_header\n"
        rows = "".join(f"{x} {y} {z}\n" for x, y, z in points).encode()
        path.write_bytes(
            head.encode() + (rows if kind == "ply-ascii" else points.astype(">f8").tobytes())
        )
    elif kind.startswith("pcd"):
        encoding = kind.removeprefix("pcd-")
        head = (
            "VERSION 0.7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 40\nHEIGHT 1\n"
            f"POINTS 40\nDATA {encoding}\n"
        )
        rows = "".join(f"{x} {y} {z}\n" for x, y, z in points).encode()
        path.write_bytes(head.encode() + (rows if encoding == "ascii" else points.tobytes()))
    else:
        data = trimesh.creation.box().export(file_type=kind)
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


def damage(data: bytes, rng: np.random.Generator) -> bytes:
    """Truncate, flip bits, overwrite, insert or repeat a piece."""
    raw = np.frombuffer(data, np.uint8).copy()
    choice = rng.integers(6)
    # Headers are short and matter most: half of all damage is done to the first 200 bytes.
    reach = min(len(raw), 200) if rng.random() < 0.5 else len(raw)
    at = int(rng.integers(reach))
    if choice == 0:
        raw = raw[:at]
    elif choice == 1:
        raw[at] ^= 1 << rng.integers(8)
    elif choice == 2:
        where = rng.integers(0, reach, 8)
        raw[where] ^= (1 << rng.integers(0, 8, 8)).astype(np.uint8)
    elif choice == 3:
        raw[at : at + 4] = rng.integers(0, 256, 4)[: len(raw[at : at + 4])]
    elif choice == 4:
        raw = np.concatenate([raw[:at], rng.integers(0, 256, 5).astype(np.uint8), raw[at:]])
    else:
        raw = np.concatenate([raw[:at], raw[at // 2 :]])
    return raw.tobytes()


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_of_every_kind(kind: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(KINDS.index(kind))
    path = good_file(kind, tmp_path)
    data = path.read_bytes()
    assert outcome(lambda: load_cloud(path)) == "result"
    came: Counter[str] = Counter()
    for _ in range(FILES_PER_KIND):
        path.write_bytes(damage(data, rng))

        def call() -> LoadedCloud:
            loaded = load_cloud(path, samples=50)
            assert np.isfinite(loaded.points).all()
            assert all("\n" not in note for note in loaded.notes)
            return loaded

        came[outcome(call)] += 1
    assert came["InputError"] + came["ReadError"] > FILES_PER_KIND // 20


def test_the_number_of_inputs() -> None:
    assert ARRAYS + FILES_PER_KIND * len(KINDS) >= 2000


@pytest.mark.parametrize(
    "options",
    [
        {"method": "nothing"},
        {"method": None},
        {"method": ["icp-point"]},
        {"seed": -1},
        {"seed": 1.5},
        {"seed": "one"},
        {"seed": None},
        {"seed": True},
        {"source_viewpoint": [1, 2]},
        {"target_viewpoint": "here"},
        {"target_viewpoint": [1, 2, np.nan]},
        {"source_viewpoint": object()},
        {"source_viewpoint": [[1, 2, 3]]},
    ],
    ids=lambda options: json.dumps(options, default=lambda thing: type(thing).__name__),
)
def test_options_of_every_sort(options: dict[str, Any]) -> None:
    cloud = bracket(60)
    assert outcome(lambda: register(cloud, cloud, **{"method": "icp-point", **options})) == (
        "InputError"
    )
