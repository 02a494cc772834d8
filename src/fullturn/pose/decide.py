"""The search and the verdict on what it found; a second, wider look where that is doubt."""

from __future__ import annotations

import torch

from fullturn.geometry.cloud import Cloud
from fullturn.pose.search import Finalists, Search, SearchConfig
from fullturn.pose.similarity import Similarity
from fullturn.pose.verdict import Judged, judge

_DOUBT = 0.15  # probability of "none of them" above which more poses are looked at
# How many times as many are refined, and measured: more of the latter found no more.
_MODES, _FINALISTS = 4, 2


# In thousands of small operations, what autograd keeps of each is a tenth of the time.
@torch.inference_mode()
def find_and_judge(
    source: Cloud,
    target: Cloud,
    *,
    config: SearchConfig,
    similarity: Similarity | None = None,
    max_rotation_rad: float | None = None,
) -> tuple[Finalists, Judged]:
    """The finalists, and how probable each one is; arguments as of `Search`."""
    search = Search(
        source, target, config=config, similarity=similarity, max_rotation_rad=max_rotation_rad
    )
    for width in (config, config.wider(modes=_MODES, finalists=_FINALISTS)):
        found = search.finalists(width)
        judged = judge(found.T_target_source, found.features, max_rotation_rad=max_rotation_rad)
        if judged.doubt <= _DOUBT:
            break
    return found, judged
