"""Weight files of GMCNet: found by name or path, read strictly."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open

from fullturn.errors import InputError, ReadError, one_line
from fullturn.methods.learned.gmcnet import GMCNet
from fullturn.nn.config import GMCNetConfig

RUN_FILE = "weights.safetensors"  # of a run's folder
_PREFIX, _SUFFIX = "gmcnet-", ".safetensors"
_KEY = "gmcnet"  # of the metadata: the shape of the network as JSON


def shipped() -> tuple[str, ...]:
    """The names of the weights inside the package."""
    folder = Path(str(resources.files("fullturn"))) / "weights"
    found = sorted(folder.glob(f"{_PREFIX}*{_SUFFIX}"))
    return tuple(path.name.removeprefix(_PREFIX).removesuffix(_SUFFIX) for path in found)


def find_weights(name: str) -> Path:
    """The file of weights that are in the package, or of a path.

    Raises:
        InputError: neither a name nor a .safetensors file.
    """
    if name in shipped():
        return Path(str(resources.files("fullturn"))) / "weights" / f"{_PREFIX}{name}{_SUFFIX}"
    path = Path(name)
    if path.suffix == _SUFFIX and path.is_file():
        return path
    names = ", ".join(shipped()) or "no name, as none are shipped,"
    raise InputError(
        f"weights: expected {names} or the path of a {_SUFFIX} file that `fullturn train` wrote; "
        f"got {name!r:.200}"
    )


def load_gmcnet(path: Path) -> GMCNet:
    """The network of a file, in evaluation mode; every weight must be there, and no other.

    Raises:
        ReadError: not such a file, another network, or weights that don't fit.
    """
    try:
        with safe_open(path, framework="pt") as file:
            table = json.loads((file.metadata() or {})[_KEY])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        # The weights that are drawn here are overwritten; the caller's generator stays as it was.
        with torch.random.fork_rng(devices=[]):
            network = GMCNet(_config(table))
        network.load_state_dict(tensors, strict=True)
    except (OSError, SafetensorError, ValueError, KeyError, TypeError, RuntimeError) as error:
        told = one_line(error)[:300]
        raise ReadError(
            f"expected weights of GMCNet in {path}, as `fullturn train` writes them; reading gives "
            f"{type(error).__name__}: {told}"
        ) from error
    return network.eval().requires_grad_(False)


def _config(table: dict[str, Any]) -> GMCNetConfig:
    fields: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value for key, value in table.items()
    }
    return GMCNetConfig(**fields)
