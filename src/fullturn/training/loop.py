"""The training loop: steps, averages, validations and checkpoints, resumable to the bit."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import torch
from torch import nn
from torch.nn.parallel import DistributedDataParallel

from fullturn.errors import FullturnError
from fullturn.training.average import WeightAverage
from fullturn.training.batches import PairBatch, Steps, stream
from fullturn.training.checkpoint import State, save_state, weights_file
from fullturn.training.config import TrainConfig
from fullturn.training.log import RunLog
from fullturn.training.objective import Objective
from fullturn.training.pairs import RunPairs
from fullturn.training.ranks import Ranks
from fullturn.training.schedule import learning_rate
from fullturn.training.strict import to_table
from fullturn.training.validation import Score, Validation

_AT_ONCE = 16  # numbers of pairs that an error message lists


@runtime_checkable
class Watcher(Protocol):
    """Whoever is told how a run goes; only the first process tells."""

    def start(self, step: int, *, total: int | None) -> None: ...
    def step(self, step: int, *, loss: float, seconds: float, pairs: int) -> None: ...
    def score(self, score: Score, *, is_best: bool) -> None: ...


class Trainer:
    """One run in this process.

    A step:
    1. take the pairs of its number;
    2. forward and backward;
    3. agree with the other processes: the mean loss, whether all numbers are finite, whether to go
       on;
    4. clip, then step with the rate of its number;
    5. average the weights;
    6. log, validate and save when it is time.

    Nothing in a step depends on how many came before it in this process: pairs, rate and random
    numbers follow from the number of the step, all else is in the `State`.
    """

    def __init__(
        self,
        config: TrainConfig,
        objective: Objective,
        *,
        pairs: RunPairs,
        validation: Validation,
        total: int | None,
        out: Path,
        device: torch.device,
        ranks: Ranks,
        state: State | None = None,
    ) -> None:
        self._config, self._objective, self._out = config, objective, out
        self._pairs, self._validation, self._total = pairs, validation, total
        self._device, self._ranks = device, ranks
        with seeded(config.seed, device=device):
            self.model = objective.model(config).to(device)
        self._parameters = [p for p in self.model.parameters() if p.requires_grad]
        kind = {"adam": torch.optim.Adam, "adamw": torch.optim.AdamW}[config.optimizer.name]
        self._optimizer = kind(
            self._parameters,
            lr=config.optimizer.rate,
            weight_decay=config.optimizer.weight_decay,
        )
        self.average = WeightAverage(self.model, decay=config.optimizer.ema)
        self.step = 0
        self.best: Score | None = None
        self.best_weights: bytes | None = None
        self.scores: list[Score] = []
        self._seconds_before = self._cpu_before = 0.0
        if state is not None:
            self._restore(state)
        self._begin, self._cpu_begin = time.perf_counter(), time.process_time()
        # Wrapped last, so that every process has the same weights already.
        self._shared: nn.Module = self.model
        if ranks.size > 1:
            self._shared = DistributedDataParallel(_synchronized(self.model, device))

    @property
    def seconds(self) -> float:
        """Wall-clock seconds of the run, earlier parts included."""
        return self._seconds_before + time.perf_counter() - self._begin

    @property
    def cpu_seconds(self) -> float:
        """CPU seconds of this process and of those before it that it was resumed from."""
        return self._cpu_before + time.process_time() - self._cpu_begin

    @property
    def pairs_seen(self) -> int:
        return self.step * self._config.data.batch

    def run(self, *, watcher: Watcher, stop: Callable[[], bool]) -> bool:
        """Train until the budget is spent (True) or `stop()` says so (False); save at the end.

        Raises:
            FullturnError: the loss or its gradient isn't finite; the state before that is saved.
        """
        log = None
        if self._ranks.is_first:
            watcher.start(self.step, total=self._total)
            log = RunLog(self._out, losses=list(self._objective.losses), step=self.step)
        steps = Steps(
            self._pairs, self._config.data.batch, rank=self._ranks.rank, size=self._ranks.size
        )
        batches = stream(steps, first=self.step, workers=self._config.machine.workers)
        self._shared.train()
        stopped = False
        try:
            while not (self._is_spent() or stopped):
                stopped = self._step(next(batches), log, watcher, stop)
            if not stopped and (not self.scores or self.scores[-1].step != self.step):
                self._validate(log, watcher)
            self.save(log)
        finally:
            batches.close()
            if log is not None:
                log.flush()
        return not stopped

    def save(self, log: RunLog | None = None) -> None:
        """Write the state into the run folder, after the rows that belong to it."""
        if not self._ranks.is_first:
            return
        if log is not None:
            log.flush()
        weights = {f"model.{name}": t for name, t in self.model.state_dict().items()}
        if self.average.model is not self.model:
            averaged = self.average.model.state_dict()
            weights |= {f"average.{name}": tensor for name, tensor in averaged.items()}
        record = {
            "recipe": to_table(self._config),
            "total": self._total,
            "seconds": self.seconds,
            "cpu_seconds": self.cpu_seconds,
            "best": None if self.best is None else dataclasses.asdict(self.best),
            "scores": [dataclasses.asdict(score) for score in self.scores],
        }
        optimizer = self._optimizer.state_dict()
        save_state(self._out, State(self.step, weights, self.best_weights, optimizer, record))

    def _step(
        self, batch: PairBatch, log: RunLog | None, watcher: Watcher, stop: Callable[[], bool]
    ) -> bool:
        # 1. Pairs
        batch = batch.to(self._device)
        rate = learning_rate(self.step, self._config.optimizer, total=self._total)
        # 2. Forward and backward
        self._optimizer.zero_grad(set_to_none=True)
        buffers = [buffer.clone() for buffer in self.model.buffers()]
        with seeded(self._config.seed, self.step, self._ranks.rank, device=self._device):
            answer = self._shared(batch.source, batch.target)
            total, each = self._objective.costs(answer, batch)
            total.backward()
        # 3. Agreement
        limit = self._config.optimizer.clip
        gradient = nn.utils.clip_grad_norm_(self._parameters, math.inf if limit is None else limit)
        values = torch.stack([total, *each.values(), gradient]).detach().double().tolist()
        mean = self._ranks.mean([*values, float(stop())], device=self._device)
        *values, stopping = mean
        if not all(map(math.isfinite, values)):
            # A forward pass moves the statistics of batch norms.
            for buffer, before in zip(self.model.buffers(), buffers, strict=True):
                buffer.copy_(before)
            self._give_up(values, batch, log)
        # 4. Step
        for group in self._optimizer.param_groups:
            group["lr"] = rate
        self._optimizer.step()
        self.step += 1
        # 5. Average
        self.average.update(self.step)
        # 6. Records
        loss, *parts, gradient_norm = values
        if log is not None:
            log.add_step(
                step=self.step,
                pairs=self.pairs_seen,
                rate=rate,
                loss=loss,
                **dict(zip(each, parts, strict=True)),
                gradient=gradient_norm,
                seconds=round(self.seconds, 3),
            )
            watcher.step(self.step, loss=loss, seconds=self.seconds, pairs=self.pairs_seen)
        if self.step % self._config.validation.every == 0:
            self._validate(log, watcher)
        if self.step % self._config.machine.checkpoint_every == 0:
            self.save(log)
        return stopping > 0.0

    def _is_spent(self) -> bool:
        if self.step == 0:
            return False
        budget = self._config.budget
        late = budget.seconds is not None and self.seconds >= budget.seconds
        late |= budget.cpu_seconds is not None and self.cpu_seconds >= budget.cpu_seconds
        # Clocks differ: all stop where one does.
        if budget.seconds is not None or budget.cpu_seconds is not None:
            late = self._ranks.mean([float(late)], device=self._device)[0] > 0.0
        return late or (self._total is not None and self.step >= self._total)

    def _validate(self, log: RunLog | None, watcher: Watcher) -> None:
        score = self._validation.score(self.average.model, step=self.step, device=self._device)
        self.scores.append(score)
        is_best = self.best is None or score.mean_deg < self.best.mean_deg
        if is_best:
            self.best = score
            self.best_weights = weights_file(self.average.model.state_dict())
        if log is not None:
            log.add_score(score)
            watcher.score(score, is_best=is_best)

    def _give_up(self, values: list[float], batch: PairBatch, log: RunLog | None) -> None:
        # Weights, average and optimizer are still those of the last good step.
        self.save(log)
        numbers = [n for part in self._ranks.gather(list(batch.numbers)) for n in part]
        shapes = dict.fromkeys(self._pairs.name(number) for number in numbers[:_AT_ONCE])
        what = "gradient" if all(map(math.isfinite, values[:-1])) else "loss"
        raise FullturnError(
            f"the {what} isn't finite in step {self.step + 1} (loss {values[0]:g}, gradient "
            f"{values[-1]:g}), pairs {numbers[0]} to {numbers[-1]}: {', '.join(shapes)}; the "
            f"state after step {self.step} is in {self._out}: lower optimizer.rate or set "
            "optimizer.clip"
        )

    def _restore(self, state: State) -> None:
        wrapped = self.average.model is not self.model
        parts: dict[str, dict[str, Any]] = {"model": {}, "average": {}}
        for name, tensor in state.weights.items():
            part, _, key = name.partition(".")
            parts[part][key] = tensor
        self.model.load_state_dict(parts["model"])
        if wrapped:
            self.average.model.load_state_dict(parts["average"])
        self._optimizer.load_state_dict(dict(state.optimizer))
        self.step, self.best_weights = state.step, state.best
        record = state.record
        self._seconds_before, self._cpu_before = record["seconds"], record["cpu_seconds"]
        self.scores = [Score(**score) for score in record["scores"]]
        self.best = None if record["best"] is None else Score(**record["best"])


@contextmanager
def seeded(*numbers: int, device: torch.device) -> Iterator[None]:
    """Random numbers inside follow from `numbers` alone; torch's own generators are put back.

    Layers draw their first weights, and dropout, from these generators; nothing can be passed in.
    """
    seed = 0
    for number in numbers:
        seed = (seed * 1_000_003 + number + 1) % 2**63
    gpus = [device] if device.type == "cuda" else []
    with torch.random.fork_rng(devices=gpus):
        torch.set_rng_state(torch.Generator().manual_seed(seed).get_state())
        for gpu in gpus:
            torch.cuda.set_rng_state(torch.Generator(gpu).manual_seed(seed).get_state(), gpu)
        yield


def _synchronized(model: nn.Module, device: torch.device) -> nn.Module:
    """Batch norms that count the pairs of all processes, where there are any and torch can."""
    return nn.SyncBatchNorm.convert_sync_batchnorm(model) if device.type == "cuda" else model
