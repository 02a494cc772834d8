"""What is trained, and towards what: a model and its weighted losses."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from torch import Tensor, nn

from fullturn.methods.learned.gmcnet import GMCNet
from fullturn.training import losses
from fullturn.training.batches import PairBatch
from fullturn.training.config import LossConfig, TrainConfig

# (what the model returned, source, target, T_true) → the mean over the batch
Loss = Callable[[Any, Any, Any, Tensor], Tensor]


@dataclass(frozen=True)
class Objective:
    """A model, called with (source, target), and what its answers cost.

    An answer has `T_target_source` (b, 4, 4), which validation scores.
    """

    model: Callable[[TrainConfig], nn.Module]
    losses: Mapping[str, tuple[float, Loss]]  # name: (weight, loss)

    def costs(self, answer: Any, batch: PairBatch) -> tuple[Tensor, dict[str, Tensor]]:
        """The weighted sum, and each loss by name without its weight."""
        each = {
            name: loss(answer, batch.source, batch.target, batch.T_target_source)
            for name, (_, loss) in self.losses.items()
        }
        total = sum(self.losses[name][0] * value for name, value in each.items())
        return total, each  # type: ignore[return-value]


def gmcnet_objective(config: TrainConfig) -> Objective:
    """The paper's network with the losses of the recipe."""
    return Objective(lambda recipe: GMCNet(recipe.model), weighted_losses(config.loss))


def weighted_losses(config: LossConfig) -> dict[str, tuple[float, Loss]]:
    """The losses with a weight above 0."""
    paper = partial(losses.paper_loss, cycle=config.cycle, inlier_weight=config.inlier_weight)
    known = {
        "paper": (config.paper, paper),
        "correspondence": (
            config.correspondence,
            partial(losses.correspondence_loss, radius=config.radius),
        ),
    }
    return {name: (weight, loss) for name, (weight, loss) in known.items() if weight > 0.0}
