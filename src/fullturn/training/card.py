"""The card beside a weight file: what it was made from, by what, and how good it is."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping, Sequence
from typing import Any

import torch

import fullturn
from fullturn.data.provenance import working_tree_commit
from fullturn.training.config import TrainConfig
from fullturn.training.strict import to_table, to_toml
from fullturn.training.validation import Score

_CARD = """# {name}

Weights of GMCNet ({parameters:,} parameters){row}.

- File: `weights.safetensors`, SHA-256 `{sha256}`.
- Loss: {loss}.
- Seen: {pairs:,} pairs in {steps:,} steps.
- Time: {seconds} wall clock, {cpu} of CPU, on {machine}.
- Code: fullturn {version}, commit {commit}.

## Scores

{scores}

## Data

Trained on

{shapes}

Validated on

{held_out}

Weights carry the licenses of their data: a place without one is for research alone.

## Recipe

```toml
{recipe}```
"""


def card(
    config: TrainConfig,
    *,
    weights: bytes,
    parameters: int,
    steps: int,
    pairs: int,
    seconds: float,
    cpu_seconds: float,
    best: Score | None,
    shapes: Sequence[Mapping[str, Any]],
    held_out: Sequence[Mapping[str, Any]],
    device: torch.device,
    processes: int,
) -> str:
    """The card as Markdown."""
    return _CARD.format(
        name=config.name,
        parameters=parameters,
        row=f", for {config.row}" if config.row else "",
        sha256=hashlib.sha256(weights).hexdigest(),
        loss=_losses(config),
        pairs=pairs,
        steps=steps,
        seconds=_duration(seconds),
        cpu=_duration(cpu_seconds),
        machine=_machine(device, processes),
        version=fullturn.__version__,
        commit=working_tree_commit() or "unknown",
        scores=_scores(best),
        shapes="\n".join(map(_place, shapes)),
        held_out="\n".join(map(_place, held_out)),
        recipe=to_toml(to_table(config)),
    )


def _losses(config: TrainConfig) -> str:
    loss, told = config.loss, []
    if loss.paper > 0.0:
        ways = "both directions" if loss.cycle else "one direction"
        told.append(f"{loss.paper:g} × the paper's, {ways}, without correspondences")
    if loss.correspondence > 0.0:
        told.append(f"{loss.correspondence:g} × cross-entropy on true correspondences")
    return "; ".join(told)


def _scores(best: Score | None) -> str:
    if best is None:
        return "None: the run ended before its first validation."
    return (
        "Of the averaged weights with the least mean error on the validation pairs:\n\n"
        "| step | pairs | mean | median | below 1° | below 5° |\n"
        "|---:|---:|---:|---:|---:|---:|\n"
        f"| {best.step} | {best.pairs} | {best.mean_deg:.2f}° | {best.median_deg:.2f}° | "
        f"{best.below_1:.3f} | {best.below_5:.3f} |"
    )


def _place(place: Mapping[str, Any]) -> str:
    words = [str(place["kind"])]
    words += [str(place["file"])] if place.get("file") else []
    words += [f"part {place['part']}"] if place.get("part") else []
    words += [f"seed {place['seed']}"] if "seed" in place else []
    words += [f"sources {', '.join(place['sources'])}"] if place.get("sources") else []
    words += [f"{place['used']} of {place['count']} shapes", f"{place['share']:.0%} of the pairs"]
    words += [f"SHA-256 `{place['sha256']}`"] if place.get("sha256") else []
    return f"- {', '.join(words)}. License: {place.get('license') or 'none stated'}."


def _duration(seconds: float) -> str:
    """A time in its own unit.

    >>> _duration(90.0), _duration(7300.0)
    ('1.5 min', '2.0 h')
    """
    if seconds < 60.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.1f} min" if seconds < 3600.0 else f"{seconds / 3600.0:.1f} h"


def _machine(device: torch.device, processes: int) -> str:
    if device.type == "cuda":
        place = torch.cuda.get_device_name(device)
    else:
        place = f"CPU ({platform.machine()}, {torch.get_num_threads()} threads)"
    return f"{place}, torch {torch.__version__}" + (
        f", {processes} processes" if processes > 1 else ""
    )
