"""The files of a built MVP-RG set: some pairs as bytes, and what a shard tells of itself."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fullturn.data.mvp_pair import MadePair
from fullturn.data.mvp_rg import SHARD_KEYS
from fullturn.data.npz import npz_bytes, open_npz
from fullturn.data.provenance import sha256_of_file
from fullturn.errors import ReadError

TALLIED = ("match_level", "rotation_level", "category")


@dataclass(frozen=True)
class Shard:
    """Which pairs a file holds, and of which set."""

    file: str
    split: str
    first: int
    count: int
    plan: str  # hash of all that the pairs depend on

    def facts(self) -> dict[str, Any]:
        """What the file says of itself."""
        return {"plan": self.plan, "file": self.file, "first": self.first, "count": self.count}


@dataclass(frozen=True, eq=False)
class ShardSummary:
    """What the manifest tells of a shard."""

    sha256: str
    names: frozenset[str]  # of the shapes in it
    tallies: Mapping[str, Counter[str]]  # of `TALLIED`: how often each value comes
    skips: Counter[str]  # by reason


def shard_bytes(shard: Shard, pairs: Sequence[MadePair]) -> bytes:
    """The content of a shard's `.npz` file: the same pairs give the same bytes.

    Clouds are float32, poses and viewpoints float64; `shard` is a JSON text with what the shard is
    and all that was skipped, as (pair, shape, reason).
    """

    def column(key: str, dtype: str | None = None) -> np.ndarray:
        return np.array([getattr(pair, key) for pair in pairs], dtype=dtype)

    told = {**shard.facts(), "skips": [skip for pair in pairs for skip in pair.skips]}
    return npz_bytes(
        {
            "shard": np.array(json.dumps(told, ensure_ascii=False)),
            "source": column("source", "<f4"),
            "target": column("target", "<f4"),
            "T_target_source": column("T_target_source", "<f8"),
            "source_viewpoint": column("source_viewpoint", "<f8"),
            "target_viewpoint": column("target_viewpoint", "<f8"),
            "name": column("name"),
            "category": column("category"),
            "overlap": column("overlap", "<f8"),
            "match_level": column("match_level", "<i1"),
            "rotation_level": column("rotation_level", "<i1"),
        }
    )


def summarize_shard(
    folder: Path, shard: Shard, *, sha256: str | None = None
) -> ShardSummary | None:
    """The summary of a finished shard; None where it is missing, damaged or of another set.

    `sha256`: the hash that it must have, if that is known.
    """
    path = folder / shard.file
    if not path.exists():
        return None
    try:
        found = sha256_of_file(path)
        arrays = open_npz(path, SHARD_KEYS)
        told = json.loads(str(arrays["shard"]))
        if sha256 not in (None, found) or any(told[k] != v for k, v in shard.facts().items()):
            return None
        return ShardSummary(
            found,
            frozenset(arrays["name"].tolist()),
            {key: Counter(str(value) for value in arrays[key].tolist()) for key in TALLIED},
            Counter(str(reason) for _, _, reason in told["skips"]),
        )
    except (ReadError, ValueError, KeyError, AttributeError, TypeError):
        return None
