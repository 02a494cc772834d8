"""The methods that the contract is held against; those that can't run here are skipped by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fullturn.errors import DependencyError
from fullturn.methods.registry import get, names

# A method from outside the package, asked for as its users do.
OWN = f"{Path(__file__).parents[2] / 'examples' / 'own_method.py'}:PcaAxes"


def _param(name: str) -> Any:
    try:
        get(name)()
    except DependencyError as error:
        return pytest.param(name, marks=pytest.mark.skip(reason=str(error)))
    return pytest.param(name, id=name.rpartition(":")[2])


# ransac but for the number of rounds: a few clauses say enough.
SLOW = [_param("ransac-4m")]
METHODS = [_param(name) for name in (*names(), OWN) if name != "ransac-4m"]
