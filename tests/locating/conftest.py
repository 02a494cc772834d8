"""Prepared models for all tests of a process: they take seconds."""

from __future__ import annotations

import pytest
import trimesh
from locate_scenes_of import model

from fullturn.locating.model import ModelConfig, PreparedModel, prepare


@pytest.fixture(scope="session")
def dog_model() -> PreparedModel:
    return prepare(model())


@pytest.fixture(scope="session")
def box_model() -> PreparedModel:
    box = trimesh.creation.box((1.3, 0.8, 0.45))
    return prepare(box, config=ModelConfig(views=12, level_points=(200,)))
