"""Networks whose weights come with the package."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib import resources
from typing import Any, TypeVar

import torch
from torch import nn

from fullturn.errors import ReadError, one_line

_Network = TypeVar("_Network", bound=nn.Module)


def load_packaged(file: str, build: Callable[[dict[str, Any]], _Network]) -> _Network | None:
    """The network that `build` makes of the file's configuration, with its weights, for evaluation.

    None where the file is missing.

    Raises:
        ReadError: weights of another network.
    """
    from safetensors import SafetensorError, safe_open

    path = resources.files("fullturn") / "weights" / file
    if not path.is_file():
        return None
    try:
        with resources.as_file(path) as place, safe_open(place, framework="pt") as stored:
            config = json.loads(stored.metadata()["config"])
            tensors = {key: stored.get_tensor(key) for key in stored.keys()}  # noqa: SIM118
        # What is drawn here is overwritten; the caller's generator stays as it was.
        with torch.random.fork_rng(devices=[]):
            network = build(config)
        network.load_state_dict(tensors, strict=True)
    except (SafetensorError, RuntimeError, KeyError, TypeError, ValueError) as error:
        raise ReadError(
            f"expected the weights of this version's network in {path}: {one_line(error)}; "
            "install fullturn again"
        ) from error
    return network.eval()
