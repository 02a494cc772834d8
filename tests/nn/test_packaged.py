"""Networks of the package: missing weights, and weights of something else."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
import torch
from safetensors.torch import save_file

from fullturn.errors import ReadError
from fullturn.nn import packaged
from fullturn.nn.confidence import load_confidence_net
from fullturn.nn.evidence import load_evidence_net
from fullturn.nn.surface import load_surface_net

EVIDENCE = {"signals": ["a", "b", "c", "d"], "compared": ["b", "d"], "width": 8}


@pytest.mark.parametrize(
    ("load", "name", "config"),
    [
        (load_surface_net, "descriptor", {}),
        (load_evidence_net, "evidence", EVIDENCE),
        (load_confidence_net, "confidence", {"inputs": ["a"], "width": 8}),
    ],
)
def test_weights_of_another_network_are_refused(
    load: Callable[[], Any],
    name: str,
    config: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    folder = tmp_path_factory.mktemp("package")
    (folder / "weights").mkdir()
    monkeypatch.setattr(packaged.resources, "files", lambda package: folder)
    afresh = load.__wrapped__  # type: ignore[attr-defined]
    assert afresh() is None
    path = folder / "weights" / f"{name}.safetensors"
    save_file({"x": torch.zeros(1)}, path, metadata={"config": json.dumps(config)})
    with pytest.raises(ReadError, match=name):
        afresh()
    path.write_bytes(b"no weights")
    with pytest.raises(ReadError, match=name):
        afresh()
