"""States of a run on disk, from which it goes on as if it had never stopped.

A state is two files of one step: `step-N.safetensors` with the weights, and `step-N.pt` with the
rest, which is written last and knows the hash of the first. Whatever happens in between, the newest
whole pair is there. Nothing in them is a pickled object: both load with `weights_only`.
"""

from __future__ import annotations

import hashlib
import io
import os
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load, save
from torch import Tensor

from fullturn.errors import ReadError, one_line
from fullturn.io.atomic import make_folder, write_atomic

FORMAT = 1
_FOLDER = "checkpoints"


@dataclass(frozen=True, eq=False)
class State:
    """All that a run needs to go on."""

    step: int  # steps done
    weights: Mapping[str, Tensor]  # "model.…" and, where there is one, "average.…"
    best: bytes | None  # the best weights so far, as a safetensors file
    optimizer: Mapping[str, Any]
    record: Mapping[str, Any]  # numbers and texts: recipe, seconds, scores


def save_state(out: Path, state: State) -> None:
    """Write a state into the run folder, and remove what it replaces.

    Raises:
        WriteError: the folder cannot be written.
    """
    folder = out / _FOLDER
    make_folder(folder)
    stem = f"step-{state.step:09d}"
    content = {f"{stem}.safetensors": save(_whole(state.weights))}
    if state.best is not None:
        content[f"{stem}.best.safetensors"] = state.best
    rest = {
        "format": FORMAT,
        "step": state.step,
        "sha256": {name: hashlib.sha256(data).hexdigest() for name, data in content.items()},
        "optimizer": state.optimizer,
        "record": state.record,
    }
    stream = io.BytesIO()
    torch.save(rest, stream)
    for name, data in content.items():
        write_atomic(folder / name, data)
    write_atomic(folder / f"{stem}.pt", stream.getvalue())
    for old in folder.iterdir():
        if old.name.startswith("step-") and not old.name.startswith(f"{stem}."):
            old.unlink()


def has_state(out: Path) -> bool:
    """Whether a run has left a state in this folder."""
    return any((out / _FOLDER).glob("step-*.pt"))


def load_state(out: Path) -> State:
    """The newest whole state of a run folder, on the CPU.

    Raises:
        ReadError: there is none, or its files are damaged.
    """
    paths = sorted((out / _FOLDER).glob("step-*.pt"))
    if not paths:
        raise ReadError(f"expected checkpoints in {out / _FOLDER}, found none; start without them")
    path = paths[-1]
    try:
        rest = torch.load(path, map_location="cpu", weights_only=True)
        if rest["format"] != FORMAT:
            raise ValueError(f"format {rest['format']}, expected {FORMAT}")
        content = {name: (path.parent / name).read_bytes() for name in rest["sha256"]}
        for name, data in content.items():
            if hashlib.sha256(data).hexdigest() != rest["sha256"][name]:
                raise ValueError(f"{name} isn't the file that was written with it")
        return State(
            rest["step"],
            load(content[f"{path.stem}.safetensors"]),
            content.get(f"{path.stem}.best.safetensors"),
            rest["optimizer"],
            rest["record"],
        )
    except (OSError, ValueError, KeyError, RuntimeError, EOFError, pickle.UnpicklingError) as error:
        raise ReadError(
            f"expected a whole checkpoint at {path}, cannot read it: {one_line(error)}; "
            f"remove {os.fspath(path)} and go on from the one before, or start again"
        ) from error


def weights_file(tensors: Mapping[str, Tensor], metadata: dict[str, str] | None = None) -> bytes:
    """Weights as the bytes of a safetensors file."""
    return bytes(save(_whole(tensors), metadata))


def _whole(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    # Shared or strided memory is no safetensors file.
    return {name: tensor.detach().clone().contiguous() for name, tensor in tensors.items()}
