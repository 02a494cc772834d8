"""Packages that only the baselines need: imported when a method is made, or a named error."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from fullturn.errors import DependencyError, one_line

_INSTALL = 'pip install "fullturn[baselines]"'


def open3d() -> Any:
    """The module open3d.

    Raises:
        DependencyError: it is not installed, or a library of the system that it needs isn't.
    """
    return _imported("open3d", "on Debian and Ubuntu, it also needs apt install libusb-1.0-0")


def kiss_matcher() -> Any:
    """The module kiss_matcher.

    Raises:
        DependencyError: it is not installed.
    """
    return _imported("kiss_matcher", "it has wheels for Python 3.11 and 3.12")


def _imported(name: str, advice: str) -> Any:
    try:
        return import_module(name)
    # A missing library of the system is an OSError; each is a baseline that can't run here.
    except (ImportError, OSError) as error:
        told = one_line(error)[:200]
        raise DependencyError(
            f"expected the package {name}, importing it gives: {told}; install it with {_INSTALL}; "
            f"{advice}"
        ) from error
