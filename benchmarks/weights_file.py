"""Write fitted weights into the package, and their card beside them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors.torch import save_file
from torch import Tensor


def write_weights(
    tensors: Mapping[str, Tensor], path: Path, *, metadata: Mapping[str, Any], card: str
) -> None:
    """A .safetensors file whose `metadata` are JSON values, and a .md file of the same name."""
    contiguous = {name: value.contiguous() for name, value in tensors.items()}
    save_file(contiguous, path, metadata={key: json.dumps(v) for key, v in metadata.items()})
    path.chmod(0o644)
    path.with_suffix(".md").write_text(card)
    print("wrote", path)
