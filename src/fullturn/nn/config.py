"""What the network looks like: every choice in one place, and the paper's three presets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args, get_type_hints

from fullturn.errors import InputError

# r1 and r2 of G2: channels of the hidden attention map, and channels that share a weight.
SHARE = 8


@dataclass(frozen=True)
class GMCNetConfig:
    """Shape of GMCNet. The defaults are the preset ``clean``.

    Raises InputError for values that cannot be built, all of them at once.
    """

    features: Literal["ppf", "rri", "fpfh"] = "ppf"  # rotation-invariant (RI) input
    rif_only: bool = False  # RI features alone, no XYZ and ΔXYZ
    neighbors: tuple[int, int, int] = (5, 5, 5)  # k of each level, the point itself included
    sampling: tuple[int, int] = (2, 4)  # D1, D2: levels 2 and 3 keep N/D1 and N/D2 points
    channels: tuple[int, int, int, int] = (128, 128, 32, 8)  # C0..C3 of the terms Ω, Λ1, Λ2, Λ3
    graph: bool = True  # False: each point paired with its nearest neighbor alone
    tpt: bool = True  # False: maps of each point alone in place of the transformers
    hgm: bool = True  # False: only Ω and Λ1, no coarser levels
    orientation: Literal["origin", "centroid", "none"] = "origin"  # of normals; none: folded angles
    matching: Literal["fused", "terms"] = "fused"  # G5 as released, or as in the paper
    temperature: Literal["fixed", "predicted"] = "fixed"
    alpha: float = 0.2  # energy above which a match is worse than none, where fixed
    beta: float = 1.0  # inverse temperature, where fixed
    sinkhorn_rounds: int = 5

    def __post_init__(self) -> None:
        problems = [*self._wrong_words(), *self._wrong_numbers()]
        if problems:
            raise InputError("GMCNetConfig: " + "; ".join(problems))

    @property
    def graph_neighbors(self) -> tuple[int, int, int]:
        """k of each level as built: 2 (a point and its nearest neighbor) without the graph."""
        return self.neighbors if self.graph else (2, 2, 2)

    @property
    def term_channels(self) -> tuple[int, ...]:
        """Channels of each term of the descriptor: C0..C3, or C0 and C1 without the hierarchy."""
        return self.channels if self.hgm else self.channels[:2]

    @property
    def ri_channels(self) -> int:
        """RI channels of one neighbor in the feature graphs."""
        return 8 if self.features == "rri" else 4

    @property
    def relation_channels(self) -> int:
        """Channels of ρ_ij: [p_j, p_j − p_i, RI_ij], or RI_ij alone."""
        return self.ri_channels + (0 if self.rif_only else 6)

    def _wrong_words(self) -> list[str]:
        hints = get_type_hints(GMCNetConfig)
        return [
            f"{name} must be one of {', '.join(get_args(hints[name]))}, got {value!r}"
            for name in ("features", "orientation", "matching", "temperature")
            if (value := getattr(self, name)) not in get_args(hints[name])
        ]

    def _wrong_numbers(self) -> list[str]:
        problems = []
        for name, length in (("neighbors", 3), ("sampling", 2), ("channels", 4)):
            value = getattr(self, name)
            if len(value) != length or min(value) < 1:
                problems.append(f"{name} must be {length} numbers of at least 1, got {value}")
        if problems:
            return problems
        d1, d2 = self.sampling
        if d2 < d1:
            problems.append(f"sampling must not get finer with the level, got {self.sampling}")
        c0, c1, c2, _ = self.channels
        if c1 % (2 * SHARE) or (c0 + c1) % (2 * SHARE) or c2 % (2 * SHARE):
            problems.append(
                f"channels: C1, C0 + C1 and C2 must be multiples of {2 * SHARE} "
                f"(half of each is split into {SHARE} groups), got {self.channels}"
            )
        if self.features == "fpfh" and self.orientation == "none":
            problems.append("fpfh needs oriented normals: orientation must not be 'none'")
        if self.sinkhorn_rounds < 1:
            problems.append(f"sinkhorn_rounds must be at least 1, got {self.sinkhorn_rounds}")
        return problems


PRESETS: dict[str, GMCNetConfig] = {
    "clean": GMCNetConfig(),
    "noisy": GMCNetConfig(
        neighbors=(64, 64, 64), channels=(128, 64, 32, 16), temperature="predicted"
    ),
    "noisy-unseen": GMCNetConfig(neighbors=(64, 32, 16), sampling=(4, 16), temperature="predicted"),
}
