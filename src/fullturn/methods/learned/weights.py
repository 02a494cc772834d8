"""Weight files of GMCNet: found by name or path, read strictly."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from safetensors import SafetensorError

from fullturn.errors import InputError, ReadError, one_line
from fullturn.methods.learned.gmcnet import GMCNet
from fullturn.nn.config import GMCNetConfig
from fullturn.nn.packaged import packaged_weights, read_network

RUN_FILE = "weights.safetensors"  # of a run's folder
_PREFIX, _SUFFIX = "gmcnet-", ".safetensors"
_KEY = "gmcnet"  # of the metadata: the shape of the network as JSON


def shipped() -> tuple[str, ...]:
    """The names of the weights inside the package."""
    found = sorted(packaged_weights("").glob(f"{_PREFIX}*{_SUFFIX}"))
    return tuple(path.name.removeprefix(_PREFIX).removesuffix(_SUFFIX) for path in found)


def find_weights(name: str) -> Path:
    """The file of weights that are in the package, or of a path.

    Raises:
        InputError: neither a name nor a .safetensors file.
    """
    if name in shipped():
        return packaged_weights(f"{_PREFIX}{name}{_SUFFIX}")
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
        network = read_network(path, _KEY, lambda table: GMCNet(_config(table)))
    except (OSError, SafetensorError, ValueError, KeyError, TypeError, RuntimeError) as error:
        told = one_line(error)[:300]
        raise ReadError(
            f"expected weights of GMCNet in {path}, as `fullturn train` writes them; reading gives "
            f"{type(error).__name__}: {told}"
        ) from error
    return network.requires_grad_(False)


def _config(table: dict[str, Any]) -> GMCNetConfig:
    fields: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value for key, value in table.items()
    }
    return GMCNetConfig(**fields)
