"""Every method by its name; a method's code is imported when it is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module, util
from typing import TYPE_CHECKING

from fullturn.errors import InputError
from fullturn.methods.own import own_method

if TYPE_CHECKING:
    from fullturn.methods.base import Method

DEFAULT = "consensus"

_HOMES = {
    "consensus": ("fullturn.methods.consensus", "Consensus"),
    "consensus-histogram": ("fullturn.methods.consensus", "ConsensusHistogram"),
    "icp-point": ("fullturn.methods.classical.icp", "IcpPoint"),
    "icp-plane": ("fullturn.methods.classical.icp", "IcpPlane"),
    "gicp": ("fullturn.methods.external.gicp", "Gicp"),
    "ransac": ("fullturn.methods.external.ransac", "Ransac"),
    "ransac-4m": ("fullturn.methods.external.ransac", "Ransac4M"),
    "fgr": ("fullturn.methods.external.fgr", "Fgr"),
    "kiss": ("fullturn.methods.external.kiss", "Kiss"),
}
# Weights in the package; others are asked for with @NAME or @PATH.
_LEARNED = ("gmcnet", "gmcnet+consensus")
ALIASES = {"auto": DEFAULT, "icp": "icp-plane"}


@dataclass(frozen=True)
class MethodInfo:
    """What `fullturn methods` tells about one method."""

    name: str
    summary: str
    reference: str
    local: bool  # needs the two clouds roughly aligned
    missing: tuple[str, ...]  # optional packages that it needs and that aren't installed


def names() -> tuple[str, ...]:
    """The names of all registered methods, the default one first; imports none of them."""
    return (*_HOMES, *_LEARNED)


def get(name: str) -> type[Method]:
    """The class of a method.

    Names: those registered; "auto", the default one; "icp", the better one of ICP;
    "gmcnet@WEIGHTS" and "gmcnet@WEIGHTS+consensus", by name or path; and one's own,
    "file.py:Class" or "package.module:Class".

    Raises:
        InputError: no method has this name, or one's own cannot be had.
    """
    if isinstance(name, str) and name.startswith("gmcnet"):
        # Not at the top: it brings the network along, of which the other methods know nothing.
        from fullturn.methods.learned.named import learned_method

        return learned_method(name)
    if isinstance(name, str) and (":" in name or name.endswith(".py")):
        return own_method(name)
    home = _HOMES.get(ALIASES.get(name, name)) if isinstance(name, str) else None
    if home is None:
        known = ", ".join((*ALIASES, *names()))
        raise InputError(
            f"method: expected {known}, gmcnet@WEIGHTS[+consensus], or your own as file.py:Class; "
            f"got {name!r:.200}"
        )
    found: type[Method] = getattr(import_module(home[0]), home[1])
    return found


def methods() -> tuple[MethodInfo, ...]:
    """What each registered method is, the default one first."""
    return tuple(_info(get(name)) for name in names())


def _info(method: type[Method]) -> MethodInfo:
    missing = tuple(package for package in method.needs if util.find_spec(package) is None)
    return MethodInfo(method.name, method.summary, method.reference, method.traits.local, missing)
