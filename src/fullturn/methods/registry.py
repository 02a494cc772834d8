"""Every method by its name; a method's code is imported when it is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

from fullturn.errors import InputError

if TYPE_CHECKING:
    from fullturn.methods.base import Method

DEFAULT = "consensus"

_HOMES = {
    "consensus": ("fullturn.methods.consensus", "Consensus"),
    "icp-point": ("fullturn.methods.classical.icp", "IcpPoint"),
    "icp-plane": ("fullturn.methods.classical.icp", "IcpPlane"),
}


@dataclass(frozen=True)
class MethodInfo:
    """What `fullturn methods` tells about one method."""

    name: str
    summary: str
    reference: str
    local: bool  # needs the two clouds roughly aligned


def names() -> tuple[str, ...]:
    """The names of all methods, the default one first; imports none of them."""
    return tuple(_HOMES)


def get(name: str) -> type[Method]:
    """The class of a method; "auto" is the default one.

    Raises:
        InputError: no method has this name.
    """
    home = _HOMES.get(DEFAULT if name == "auto" else name) if isinstance(name, str) else None
    if home is None:
        raise InputError(f"method: expected auto, {', '.join(_HOMES)}; got {name!r}")
    found: type[Method] = getattr(import_module(home[0]), home[1])
    return found


def methods() -> tuple[MethodInfo, ...]:
    """What each registered method is, the default one first."""
    classes = [get(name) for name in names()]
    return tuple(MethodInfo(c.name, c.summary, c.reference, c.traits.local) for c in classes)
