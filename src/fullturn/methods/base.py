"""What a registration method is: a name, declared traits and one call."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry.cloud import Cloud

if TYPE_CHECKING:
    from fullturn.pose.symmetry import CloudSymmetry


@dataclass(frozen=True)
class Traits:
    """What a method can't do. The contract test expects the matching clause to fail."""

    local: bool = False  # needs the two clouds roughly aligned: fails equivariance (clause 3)


@dataclass(frozen=True, eq=False)
class Estimate:
    """A method's answer in normalised lengths: distinct poses, the best first."""

    T_target_source: Float[Tensor, "k 4 4"]  # float64, at least one
    success_probability: Float[Tensor, " k"]  # of each pose; they sum to at most 1
    symmetry: CloudSymmetry | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)  # wall-clock, per stage


class Method(ABC):
    """Subclasses are final: one method, one class, registered in `methods/registry.py`."""

    name: ClassVar[str]
    summary: ClassVar[str]  # one line for `fullturn methods`
    reference: ClassVar[str]  # where it comes from
    traits: ClassVar[Traits] = Traits()

    @abstractmethod
    def estimate(self, source: Cloud, target: Cloud, *, rng: np.random.Generator) -> Estimate:
        """Find poses of `source` in the frame of `target`; inputs are never modified."""
