"""Register two partial 3D scans of an object under any pose."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"
__all__ = [
    "Fusion",
    "Located",
    "Registration",
    "__version__",
    "fuse",
    "load_cloud",
    "locate",
    "prepare",
    "register",
    "register_many",
]

if TYPE_CHECKING:
    from fullturn.api import register, register_many
    from fullturn.fusion.fuse import fuse
    from fullturn.fusion.result import Fusion
    from fullturn.io import load_cloud
    from fullturn.locating.locate import locate
    from fullturn.locating.model import prepare
    from fullturn.locating.result import Located
    from fullturn.result import Registration

_HOMES = {
    "register": "fullturn.api",
    "register_many": "fullturn.api",
    "fuse": "fullturn.fusion.fuse",
    "load_cloud": "fullturn.io",
    "locate": "fullturn.locating.locate",
    "prepare": "fullturn.locating.model",
    "Fusion": "fullturn.fusion.result",
    "Located": "fullturn.locating.result",
    "Registration": "fullturn.result",
}


def __getattr__(name: str) -> Any:
    # Lazy: importing fullturn must not import torch.
    if name in _HOMES:
        from importlib import import_module

        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
