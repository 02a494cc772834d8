"""Prepared models in files: tensors and JSON, never pickled objects."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save
from torch import from_numpy

from fullturn.errors import ReadError, one_line
from fullturn.io.atomic import check_output, write_atomic
from fullturn.locating.model import DescribedViews, ModelConfig, PreparedModel
from fullturn.locating.source import load_model
from fullturn.nn.packaged import packaged_weights

SUFFIX = ".safetensors"
_KIND = "fullturn prepared model"
_VERSION = "2"
_TENSORS = ("center", "surface", "normals", "area", "directions", "seen")
_NUMBERS = ("radius", "diameter", "fine_voxel", "spacing")
_VIEW_TENSORS = ("points", "normals", "descriptors", "counts")


def save_model(path: str | os.PathLike[str], model: PreparedModel) -> None:
    """Write a prepared model (.safetensors).

    Raises:
        WriteError: another suffix, or the place cannot be written.
    """
    check_output(path, (SUFFIX,))
    tensors = {name: getattr(model, name) for name in _TENSORS}
    levels = []
    for number, level in enumerate(model.levels):
        tensors |= {f"level{number}.{name}": getattr(level, name) for name in _VIEW_TENSORS}
        levels.append({"voxel": level.voxel, "spacing": level.spacing})
    about = {name: getattr(model, name) for name in _NUMBERS}
    about |= {"name": model.name, "source": model.source, "notes": model.notes, "levels": levels}
    metadata = {
        "kind": _KIND,
        "version": _VERSION,
        "config": json.dumps(asdict(model.config)),
        "descriptor": _descriptor_hash(),
        "about": json.dumps(about),
    }
    arrays = {key: np.ascontiguousarray(value.numpy(force=True)) for key, value in tensors.items()}
    metadata["content"] = _content_hash(arrays, metadata["about"])
    write_atomic(path, save(arrays, metadata))


def load_prepared(path: str | os.PathLike[str], *, model: Any = None) -> PreparedModel:
    """Read a model that `save_model` wrote; results with it are those with the model itself.

    `model`, where it is given, is what it should have been prepared from.

    Raises:
        ReadError: no such file, another kind of file, one that another version wrote, or one that
            was prepared from another model.
    """
    prepared = _load(path)
    if model is not None:
        source = load_model(model)
        if source.key != prepared.source:
            raise ReadError(
                f"{one_line(path)}: expected {source.name}, prepared; it was prepared from another "
                f"model or an older version of it ({prepared.name}); prepare this one under "
                "another name"
            )
    return prepared


def _load(path: str | os.PathLike[str]) -> PreparedModel:
    name = one_line(path)
    if not Path(path).is_file():
        raise ReadError(f"{name}: expected a file, there is none; check the path")
    try:
        with safe_open(os.fspath(path), framework="numpy") as stored:
            metadata = stored.metadata() or {}
            _check(metadata, name)
            arrays = {key: stored.get_tensor(key) for key in stored.keys()}  # noqa: SIM118
        if metadata["content"] != _content_hash(arrays, metadata["about"]):
            raise ValueError("its numbers aren't those that were written")
        tensors = {key: from_numpy(array) for key, array in arrays.items()}
        about = json.loads(metadata["about"])
        parts: dict[str, Any] = {key: tensors[key] for key in _TENSORS}
        parts |= {key: float(about[key]) for key in _NUMBERS}
        return PreparedModel(
            **parts,
            name=about["name"],
            source=about["source"],
            notes=tuple(about["notes"]),
            levels=tuple(_level(tensors, *level) for level in enumerate(about["levels"])),
            config=_config(json.loads(metadata["config"])),
        )
    except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        if isinstance(error, ReadError):
            raise
        raise ReadError(
            f"{name}: expected a prepared model, cannot read it as one "
            f"({one_line(error)[:120]}); prepare the model again"
        ) from error


def _check(metadata: dict[str, str], name: str) -> None:
    if metadata.get("kind") != _KIND:
        raise ReadError(
            f"{name}: expected a prepared model, found a file of another kind; "
            "write one with PreparedModel.save or fullturn locate --prepared"
        )
    if metadata.get("version") != _VERSION:
        raise ReadError(
            f"{name}: expected a prepared model of version {_VERSION}, found version "
            f"{one_line(metadata.get('version'))[:20]}; prepare the model again"
        )
    if metadata.get("descriptor") != _descriptor_hash():
        raise ReadError(
            f"{name}: expected the descriptors of this installation, it was prepared with others; "
            "prepare the model again"
        )


def _level(tensors: dict[str, Any], number: int, lengths: dict[str, float]) -> DescribedViews:
    parts: dict[str, Any] = {part: tensors[f"level{number}.{part}"] for part in _VIEW_TENSORS}
    return DescribedViews(**(parts | lengths))


def _config(stored: dict[str, Any]) -> ModelConfig:
    return ModelConfig(**{**stored, "level_points": tuple(stored["level_points"])})


def _content_hash(arrays: dict[str, np.ndarray], about: str) -> str:
    digest = hashlib.sha256(about.encode())
    for key in sorted(arrays):
        digest.update(f"{key} {arrays[key].dtype.str} {arrays[key].shape}".encode())
        digest.update(arrays[key].tobytes())
    return digest.hexdigest()


def _descriptor_hash() -> str:
    """Of the descriptor's weights: descriptors of different ones cannot be compared."""
    path = packaged_weights("descriptor.safetensors")
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "histogram"
