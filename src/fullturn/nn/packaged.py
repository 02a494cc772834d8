"""Networks in safetensors files: those that come with the package, and any other."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import nn

from fullturn.errors import ReadError, one_line

_Network = TypeVar("_Network", bound=nn.Module)


def packaged_weights(file: str) -> Path:
    """Where a file of weights lies in the package, if it is there."""
    return Path(str(resources.files("fullturn"))) / "weights" / file


def load_packaged(file: str, build: Callable[[dict[str, Any]], _Network]) -> _Network | None:
    """The network that `build` makes of the file's configuration, with its weights, for evaluation.

    None where the file is missing.

    Raises:
        ReadError: weights of another network.
    """
    from safetensors import SafetensorError

    path = packaged_weights(file)
    if not path.is_file():
        return None
    try:
        return read_network(path, "config", build)
    except (SafetensorError, RuntimeError, KeyError, TypeError, ValueError) as error:
        raise ReadError(
            f"expected the weights of this version's network in {path}: {one_line(error)}; "
            "install fullturn again"
        ) from error


@torch.inference_mode(False)  # whoever asks first: it stays fit for training
def read_network(path: Path, key: str, build: Callable[[dict[str, Any]], _Network]) -> _Network:
    """The network that `build` makes of the JSON under `key` of the metadata, for evaluation.

    Every weight must be there, and no other; what goes wrong is raised as it comes.
    """
    from safetensors import safe_open

    with safe_open(path, framework="pt") as stored:
        config = json.loads((stored.metadata() or {})[key])
        tensors = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118
    # What is drawn here is overwritten; the caller's generator stays as it was.
    with torch.random.fork_rng(devices=[]):
        network = build(config)
    network.load_state_dict(tensors, strict=True)
    return network.eval()
