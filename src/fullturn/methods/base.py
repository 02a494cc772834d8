"""What a registration method is: a name, declared traits and one call."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry.cloud import Cloud

if TYPE_CHECKING:
    from fullturn.pose.symmetry import CloudSymmetry


@dataclass(frozen=True)
class Traits:
    """What a method can't do, and what it takes besides two clouds.

    Where it can't do something, the contract test expects the matching clause to fail.
    """

    local: bool = False  # needs the two clouds roughly aligned: fails equivariance (clause 3)
    whole: bool = False  # needs the same part of the object in both: fails on partial ones (0)
    # Takes max_rotation_rad: the largest rotation of the source that is possible.
    limits_rotation: bool = False


@dataclass(frozen=True, eq=False)
class Estimate:
    """A method's answer in normalized lengths: distinct poses, the best first."""

    T_target_source: Float[Tensor, "k 4 4"]  # float64, at least one
    # Of each pose, summing to at most 1. None: the method states none, and whoever asks for one
    # gets the verdict of the default method, which knows no poses but these.
    success_probability: Float[Tensor, " k"] | None = None
    symmetry: CloudSymmetry | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)  # wall-clock, per stage
    notes: tuple[str, ...] = ()  # what a user should know of how the poses were found


class Method(ABC):
    """Subclasses are final: one method, one class, made without arguments.

    Ours are registered in `methods/registry.py`; anybody's own is asked for as "file.py:Class".
    """

    name: ClassVar[str]
    summary: ClassVar[str]  # one line for `fullturn methods`
    reference: ClassVar[str]  # where it comes from
    traits: ClassVar[Traits] = Traits()
    needs: ClassVar[tuple[str, ...]] = ()  # optional packages, by the names they import under
    files: ClassVar[tuple[Path, ...]] = ()  # of its own, as weights, that answers depend on

    @classmethod
    def settings(cls) -> dict[str, Any]:
        """What the method was told, as JSON can hold it: its `config`, where it has one."""
        config = getattr(cls, "config", None)
        return {} if config is None else asdict(config)

    @abstractmethod
    def estimate(self, source: Cloud, target: Cloud, *, rng: np.random.Generator) -> Estimate:
        """Find poses of `source` in the frame of `target`; inputs are never modified.

        With the trait `limits_rotation`, a method also takes the keyword
        ``max_rotation_rad: float | None = None`` and answers with no pose that turns by more, but
        for what refinement adds: 5° at most.
        """
