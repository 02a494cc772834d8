"""Register two partial 3D scans of an object under any pose."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"
__all__ = [
    "Fusion",
    "Registration",
    "__version__",
    "fuse",
    "load_cloud",
    "register",
    "register_many",
]

if TYPE_CHECKING:
    from fullturn.api import register, register_many
    from fullturn.fusion.fuse import fuse
    from fullturn.fusion.result import Fusion
    from fullturn.io import load_cloud
    from fullturn.result import Registration

_HOMES = {
    "register": "fullturn.api",
    "register_many": "fullturn.api",
    "fuse": "fullturn.fusion.fuse",
    "load_cloud": "fullturn.io",
    "Fusion": "fullturn.fusion.result",
    "Registration": "fullturn.result",
}


def __getattr__(name: str) -> Any:
    # Lazy: importing fullturn must not import torch.
    if name in _HOMES:
        from importlib import import_module

        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
