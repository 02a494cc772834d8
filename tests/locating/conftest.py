"""One prepared model for all tests of a process: it takes seconds."""

from __future__ import annotations

import pytest
from locate_scenes_of import model

from fullturn.locating.model import PreparedModel, prepare


@pytest.fixture(scope="session")
def dog_model() -> PreparedModel:
    return prepare(model())
