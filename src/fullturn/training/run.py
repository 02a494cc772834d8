"""A recipe becomes a run folder: logs, checkpoints, curves, weights and their card."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from fullturn.errors import DependencyError, InputError
from fullturn.io.atomic import make_folder, write_atomic
from fullturn.methods.learned.weights import RUN_FILE
from fullturn.threads import torch_threads
from fullturn.training.card import card
from fullturn.training.checkpoint import State, has_state, load_state, weights_file
from fullturn.training.config import TrainConfig
from fullturn.training.curves import save_loss_curves
from fullturn.training.loop import Trainer, Watcher
from fullturn.training.objective import Objective, gmcnet_objective
from fullturn.training.pairs import RunPairs
from fullturn.training.ranks import Ranks, choose_device, join_ranks
from fullturn.training.strict import to_table, to_toml
from fullturn.training.validation import Score, Validation

CARD, RECIPE, CURVES = "weights.md", "recipe.toml", "loss.png"
# What may be different where a run goes on: where it runs, and for how long.
_FREE = ("machine", "budget")


class Silence:
    """A watcher that says nothing."""

    def start(self, step: int, *, total: int | None) -> None:
        pass

    def step(self, step: int, *, loss: float, seconds: float, pairs: int) -> None:
        pass

    def score(self, score: Score, *, is_best: bool) -> None:
        pass


@dataclass(frozen=True)
class Outcome:
    """How a run ended."""

    step: int
    best: Score | None  # of the exported weights
    is_finished: bool  # False: it was asked to stop, and can go on


def train(
    config: TrainConfig,
    *,
    out: Path,
    resume: bool = False,
    data: Path | None = None,
    objective: Callable[[TrainConfig], Objective] = gmcnet_objective,
    watcher: Watcher | None = None,
    stop: Callable[[], bool] = lambda: False,
    note: Callable[[str], None] = lambda text: None,
) -> Outcome:
    """Train as `config` says and write the run folder `out`. See docs/training.md.

    `data` is a folder where paths of shapes are looked for first. `stop` is asked after every step.
    Started by torchrun, all processes share each batch, and the first one writes.

    Raises:
        InputError: data that don't fit the recipe, a folder that holds another run, a batch that
            can't be shared.
        ReadError: missing data, a damaged checkpoint.
        WriteError: `out` cannot be written.
        FullturnError: the loss isn't finite.
    """
    device = choose_device(config.machine.device)
    with torch_threads(config.machine.threads), join_ranks(device) as ranks:
        if config.data.batch % ranks.size:
            raise InputError(
                f"data.batch: expected a multiple of {ranks.size} processes, got "
                f"{config.data.batch}; change one of them"
            )
        state = _state(out, config, resume=resume, note=note if ranks.is_first else _quiet)
        if len(set(ranks.gather(0 if state is None else state.step))) > 1:
            raise InputError(
                f"expected the same checkpoint in {out} for all processes; give a folder that all "
                "machines share"
            )
        pairs = RunPairs(config.data, config.validation, part="training", folder=data)
        total = config.budget.total_steps(batch=config.data.batch, shapes=pairs.count)
        held_out = RunPairs(config.data, config.validation, part="validation", folder=data)
        validation = Validation(
            held_out, count=config.validation.pairs, batch=config.data.batch, ranks=ranks
        )
        _check_schedule(config, state, total)
        if ranks.is_first:
            _open_folder(out, config)
        trainer = Trainer(
            config,
            objective(config),
            pairs=pairs,
            validation=validation,
            total=total,
            out=out,
            device=device,
            ranks=ranks,
            state=state,
        )
        finished = trainer.run(watcher=watcher or Silence(), stop=stop)
        if ranks.is_first and finished:
            _export(out, config, trainer, pairs, held_out, device, ranks, note)
        return Outcome(trainer.step, trainer.best, finished)


def _quiet(text: str) -> None:
    pass


def _state(
    out: Path, config: TrainConfig, *, resume: bool, note: Callable[[str], None]
) -> State | None:
    if not resume and (has_state(out) or (out / RECIPE).exists()):
        raise InputError(
            f"{out} holds a run already; go on with it by --resume, or choose another folder "
            "with --out"
        )
    if not has_state(out):
        if (out / RUN_FILE).exists():
            raise InputError(
                f"expected checkpoints beside {out / RUN_FILE}, by which a run goes on, found "
                "none; put them back, or choose another folder with --out, for these weights would "
                "be lost"
            )
        if resume:
            note(f"no checkpoint in {out} yet; starting at step 0")
        return None
    state = load_state(out)
    before, now = dict(state.record["recipe"]), to_table(config)
    different = sorted(_differences(_without(before), _without(now)))
    if different:
        raise InputError(
            f"expected the recipe that the run in {out} began with, got different values of "
            f"{', '.join(different)}; use {out / RECIPE}, or choose another folder with --out"
        )
    return state


def _without(table: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key not in _FREE}


def _differences(a: Mapping[str, Any], b: Mapping[str, Any], path: str = "") -> Iterator[str]:
    for key in a.keys() | b.keys():
        one, other = a.get(key), b.get(key)
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            yield from _differences(one, other, f"{path}{key}.")
        elif one != other:
            yield f"{path}{key}"


def _check_schedule(config: TrainConfig, state: State | None, total: int | None) -> None:
    """A schedule that ends with the budget can't have another end after a restart."""
    if state is None or config.optimizer.schedule == "constant":
        return
    if state.record["total"] != total:
        raise InputError(
            f"expected the {state.record['total']} steps that the {config.optimizer.schedule} "
            f"schedule began with, got {total}; keep the budget, or train with a constant schedule"
        )


def _open_folder(out: Path, config: TrainConfig) -> None:
    make_folder(out)
    write_atomic(out / RECIPE, to_toml(to_table(config)))


def _export(
    out: Path,
    config: TrainConfig,
    trainer: Trainer,
    pairs: RunPairs,
    held_out: RunPairs,
    device: torch.device,
    ranks: Ranks,
    note: Callable[[str], None],
) -> None:
    """The best weights with the shape of their network inside, the card beside them, the curves."""
    from safetensors.torch import load

    best = trainer.best_weights
    tensors = load(best) if best else trainer.average.model.state_dict()
    # One key: the order of several is not fixed, and equal runs are to give equal bytes.
    metadata = {"gmcnet": json.dumps(to_table(config)["model"])}
    content = weights_file(tensors, metadata)
    write_atomic(out / RUN_FILE, content)
    text = card(
        config,
        weights=content,
        parameters=sum(p.numel() for p in trainer.model.parameters()),
        steps=trainer.step,
        pairs=trainer.pairs_seen,
        seconds=trainer.seconds,
        cpu_seconds=trainer.cpu_seconds,
        best=trainer.best,
        shapes=pairs.description,
        held_out=held_out.description,
        device=device,
        processes=ranks.size,
    )
    write_atomic(out / CARD, text)
    try:
        save_loss_curves(out / CURVES, out, title=f"{config.name}: {trainer.pairs_seen:,} pairs")
    except DependencyError as error:
        note(f"no curves were drawn: {error}")
