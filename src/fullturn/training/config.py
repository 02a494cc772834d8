"""What a training run is told: one frozen dataclass per concern, a unit for each number."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any, Literal

from fullturn.data.protocols import PROTOCOLS
from fullturn.errors import InputError
from fullturn.nn.config import PRESETS, GMCNetConfig


def _number(default: Any, *, least: float, most: float | None = None) -> Any:
    return field(default=default, metadata={"least": least, "most": most})


class _Checked:
    """Base of the configurations: numbers within the bounds of their fields."""

    def __post_init__(self) -> None:
        if problems := list(self._problems()):
            raise InputError("; ".join(problems))

    def _problems(self) -> Iterator[str]:
        for one in fields(self):  # type: ignore[arg-type]
            value, bounds = getattr(self, one.name), one.metadata
            if value is None or not bounds:
                continue
            least, most = bounds["least"], bounds["most"]
            if not (least <= value and (most is None or value <= most)):
                expected = f"at least {least}" if most is None else f"{least} to {most}"
                yield f"{one.name}: expected {expected}, got {value}"


@dataclass(frozen=True)
class ShapesConfig(_Checked):
    """One place that shapes come from."""

    path: str  # as `open_shapes` reads it, without the part: a file, a folder, procedural:COUNT
    part: str | None = None  # a split of a mesh pack, a use of stored points, train or test
    sources: tuple[str, ...] = ()  # the sources of a mesh pack that may be used; none named: all
    share: float = _number(1.0, least=0.0)  # of the pairs, relative to the other places


@dataclass(frozen=True)
class DataConfig(_Checked):
    """Which pairs: pair i of a run depends on this and on i alone."""

    protocols: tuple[str, ...] = ("modelnet40/clean/180",)  # of several, each pair draws one
    shapes: tuple[ShapesConfig, ...] = (ShapesConfig("procedural"),)
    classes: Literal["all", "seen"] = "all"  # seen: the first 20 of ModelNet40
    # Of an object; None: the protocol's. Virtual views take none.
    sample_points: int | None = _number(None, least=4)
    cloud_points: int | None = _number(None, least=4)  # of each cloud; None: the protocol's
    # method: clouds centered on their means and of one common length, as a method sees them;
    # made: as the protocol makes them
    frame: Literal["method", "made"] = "method"
    count: int | None = _number(None, least=1)  # different pairs; None: each one is new
    batch: int = _number(16, least=1)  # pairs in a step, over all processes
    seed: int = _number(0, least=0)

    def _problems(self) -> Iterator[str]:
        yield from super()._problems()
        for name in self.protocols:
            if name not in PROTOCOLS:
                yield f"protocols: expected names out of {', '.join(PROTOCOLS)}; got {name!r}"
            elif PROTOCOLS[name].unseen:
                yield (
                    f"protocols: {name} says which classes are tested on; train on the one "
                    'without them, with classes = "seen"'
                )
        if not self.protocols:
            yield "protocols: expected at least one"
        if not self.shapes or sum(place.share for place in self.shapes) <= 0.0:
            yield "shapes: expected at least one place with a share above 0"


@dataclass(frozen=True)
class LossConfig(_Checked):
    """Weights of the losses; a loss with weight 0 isn't computed."""

    paper: float = _number(1.0, least=0.0)  # G9, without correspondences
    cycle: bool = False  # G9 in both directions
    inlier_weight: float = _number(0.01, least=0.0)  # ω of G9
    correspondence: float = _number(0.0, least=0.0)  # cross-entropy on the true partners
    radius: float = _number(0.05, least=0.0)  # of a true partner, in the lengths of the frame

    def _problems(self) -> Iterator[str]:
        yield from super()._problems()
        if self.paper <= 0.0 and self.correspondence <= 0.0:
            yield "expected a weight above 0 for paper or correspondence"


@dataclass(frozen=True)
class OptimizerConfig(_Checked):
    """How a gradient becomes a step."""

    name: Literal["adam", "adamw"] = "adam"
    rate: float = _number(1e-3, least=0.0)  # learning rate after the warmup
    weight_decay: float = _number(0.0, least=0.0)
    schedule: Literal["constant", "linear", "cosine"] = "cosine"  # down to final_share
    final_share: float = _number(0.01, least=0.0, most=1.0)  # of the rate, at the last step
    warmup_steps: int = _number(0, least=0)  # of a linear rise from 0
    clip: float | None = _number(None, least=0.0)  # largest norm of the gradient; None: any
    ema: float = _number(0.0, least=0.0, most=0.99999)  # decay of averaged weights; 0: no average


@dataclass(frozen=True)
class BudgetConfig(_Checked):
    """When to stop: at whichever of these comes first."""

    steps: int | None = _number(None, least=1)
    pairs: int | None = _number(None, least=1)
    epochs: float | None = _number(None, least=0.0)  # pairs in numbers of training shapes
    seconds: float | None = _number(None, least=0.0)  # wall clock, resumed parts added up
    cpu_seconds: float | None = _number(None, least=0.0)  # of this process, not of data workers

    def _problems(self) -> Iterator[str]:
        yield from super()._problems()
        if all(getattr(self, one.name) is None for one in fields(self)):
            yield "expected a budget: steps, pairs, epochs, seconds or cpu_seconds"

    def total_steps(self, *, batch: int, shapes: int) -> int | None:
        """The steps that steps, pairs and epochs allow, rounded up; None: time alone is bounded."""
        pairs = [self.pairs, None if self.epochs is None else int(self.epochs * shapes)]
        steps = [-(-count // batch) for count in pairs if count is not None]
        steps += [self.steps] if self.steps is not None else []
        return max(1, min(steps)) if steps else None


@dataclass(frozen=True)
class ValidationConfig(_Checked):
    """On what, and how often, the averaged weights are scored."""

    every: int = _number(1000, least=1)  # steps
    pairs: int = _number(200, least=1)
    shapes: tuple[ShapesConfig, ...] = ()  # none: `share` of the training shapes, not trained on
    share: float = _number(0.05, least=0.0, most=0.5)


@dataclass(frozen=True)
class MachineConfig(_Checked):
    """Where it runs: nothing here changes which pairs are seen."""

    device: str = "auto"  # auto: the GPU where there is one; or cpu, cuda, cuda:1
    threads: int | None = _number(None, least=1)  # of torch; None: as torch decides
    workers: int = _number(0, least=0)  # processes that make pairs; 0: the training process itself
    checkpoint_every: int = _number(1000, least=1)  # steps


@dataclass(frozen=True)
class TrainConfig(_Checked):
    """A whole recipe."""

    name: str
    row: str = ""  # the table and row that it is for
    seed: int = _number(0, least=0)  # of the first weights, and of dropout where there is any
    model: GMCNetConfig = PRESETS["clean"]
    data: DataConfig = DataConfig()
    loss: LossConfig = LossConfig()
    optimizer: OptimizerConfig = OptimizerConfig()
    budget: BudgetConfig = BudgetConfig(steps=1000)
    validation: ValidationConfig = ValidationConfig()
    machine: MachineConfig = MachineConfig()

    def _problems(self) -> Iterator[str]:
        yield from super()._problems()
        bounded = self.budget.total_steps(batch=self.data.batch, shapes=1) is not None
        if self.optimizer.schedule != "constant" and not bounded:
            yield (
                f"optimizer.schedule: {self.optimizer.schedule} needs a budget in steps, pairs or "
                'epochs; add one, or write schedule = "constant"'
            )
