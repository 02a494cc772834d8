"""Pairs in one file: exactly those of a set, whatever happens to the code that made them."""

from __future__ import annotations

import hashlib
import json
import os
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

import fullturn
from fullturn.data.npz import npz_bytes, open_npz
from fullturn.data.pair import Pair
from fullturn.data.pair_set import PairSet
from fullturn.data.provenance import working_tree_commit
from fullturn.errors import ReadError
from fullturn.io.atomic import check_output, write_atomic

FORMAT = 1
_ARRAYS = (
    "source", "source_offsets", "source_viewpoint",
    "target", "target_offsets", "target_viewpoint",
    "T_target_source", "name", "group", "related",
)  # fmt: skip

# Only in files of pairs of which the largest rotation is known.
_LIMIT = "max_rotation_deg"

_MANIFEST = {"format", "name", "description", "seed", "count", "commit", "fullturn", "sha256"}


def freeze(pairs: PairSet, path: str | os.PathLike[str]) -> dict[str, Any]:
    """Write all pairs of a set to one `.npz` file, and return its manifest.

    The clouds of all pairs stand one after the other as float64, exactly as made, pair i from
    offset i to offset i + 1; a viewpoint or a largest rotation that isn't known is NaN. The
    manifest is a JSON text: format, name and description of the set, seed, count, commit, version,
    and a SHA-256 over the arrays. The same pairs give the same bytes; there are no pickles.

    Raises:
        WriteError: no place for it, or a name that doesn't end in .npz.
    """
    goal = check_output(path, (".npz",))
    made = list(pairs)
    arrays = {
        **_stacked("source", [pair.source for pair in made]),
        **_stacked("target", [pair.target for pair in made]),
        "source_viewpoint": np.array([_viewpoint(pair.source_viewpoint) for pair in made]),
        "target_viewpoint": np.array([_viewpoint(pair.target_viewpoint) for pair in made]),
        "T_target_source": np.array([pair.T_target_source for pair in made], dtype="<f8"),
        "name": np.array([pair.name for pair in made]),
        "group": np.array([pairs.group(index) for index in range(len(made))]),
        "related": np.array([pair.related for pair in made]),
    }
    limits = [pair.max_rotation_deg for pair in made]
    if any(limit is not None for limit in limits):
        arrays[_LIMIT] = np.array(limits, dtype="<f8")  # None becomes NaN
    manifest = {
        "format": FORMAT,
        "name": pairs.name,
        "description": pairs.description,
        "seed": pairs.description.get("seed"),
        "count": len(made),
        "commit": working_tree_commit(),
        "fullturn": fullturn.__version__,
        "sha256": _sha256(arrays),
    }
    text = json.dumps(manifest, ensure_ascii=False)
    write_atomic(goal, npz_bytes({"manifest": np.array(text), **arrays}))
    return manifest


class FrozenPairs(PairSet):
    """The pairs of a file that `freeze` wrote, under the name of the set that they came from."""

    manifest: dict[str, Any]

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Raises ReadError where the file is no frozen set, of another format, or was changed."""
        self._path = Path(path)
        content = open_npz(self._path, ("manifest", *_ARRAYS))
        self.manifest = _read_manifest(str(content["manifest"]), self._path)
        self._arrays = {key: content[key] for key in (*_ARRAYS, _LIMIT) if key in content}
        found = _sha256(self._arrays)
        if found != self.manifest["sha256"]:
            raise ReadError(
                f"{path}: expected arrays with the SHA-256 {self.manifest['sha256']}, found "
                f"{found}; the file was changed or damaged, copy or freeze it again"
            )
        self.name = str(self.manifest["name"])

    @cached_property
    def description(self) -> dict[str, Any]:
        frozen = {key: self.manifest[key] for key in ("sha256", "commit", "fullturn")}
        return {
            **self.manifest["description"],
            "frozen": {"file": self._path.name, **frozen},
        }

    def __len__(self) -> int:
        return len(self._arrays["name"])

    def pair(self, index: int) -> Pair:
        self._check_index(index)
        arrays = self._arrays
        return Pair(
            self._cloud("source", index),
            self._cloud("target", index),
            arrays["T_target_source"][index].copy(),
            str(arrays["name"][index]),
            source_viewpoint=self._viewpoint("source", index),
            target_viewpoint=self._viewpoint("target", index),
            related=bool(arrays["related"][index]),
            max_rotation_deg=self._limit(index),
        )

    def group(self, index: int) -> str:
        self._check_index(index)
        return str(self._arrays["group"][index])

    def _cloud(self, side: str, index: int) -> np.ndarray:
        begin, end = self._arrays[f"{side}_offsets"][index : index + 2]
        cloud: np.ndarray = self._arrays[side][begin:end].copy()
        return cloud

    def _viewpoint(self, side: str, index: int) -> np.ndarray | None:
        place: np.ndarray = self._arrays[f"{side}_viewpoint"][index].copy()
        return None if np.isnan(place).all() else place

    def _limit(self, index: int) -> float | None:
        limit_deg = float(self._arrays[_LIMIT][index]) if _LIMIT in self._arrays else np.nan
        return None if np.isnan(limit_deg) else limit_deg


def _stacked(side: str, clouds: list[np.ndarray]) -> dict[str, np.ndarray]:
    offsets = np.cumsum([0, *(len(cloud) for cloud in clouds)]).astype("<i8")
    return {side: np.concatenate(clouds).astype("<f8", copy=False), f"{side}_offsets": offsets}


def _viewpoint(place: np.ndarray | None) -> np.ndarray:
    return np.full(3, np.nan) if place is None else np.asarray(place, dtype="<f8")


def _sha256(arrays: dict[str, np.ndarray]) -> str:
    """Over key, type, shape and bytes of each array, by key."""
    digest = hashlib.sha256()
    for key in sorted(arrays):
        array = np.ascontiguousarray(arrays[key])
        digest.update(f"{key} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _read_manifest(text: str, path: Path) -> dict[str, Any]:
    try:
        manifest = json.loads(text)
        found = manifest["format"]
    except (ValueError, KeyError, TypeError) as error:
        raise ReadError(
            f"{path}: expected the manifest of a frozen set of pairs, cannot read it: {error}; "
            "freeze it again"
        ) from error
    if found != FORMAT:
        raise ReadError(
            f"{path}: expected format {FORMAT}, found {found}; read it with the version of "
            f"fullturn that wrote it ({manifest.get('fullturn')}), or freeze it again"
        )
    missing = sorted(_MANIFEST - manifest.keys())
    if missing:
        raise ReadError(
            f"{path}: expected a manifest with {', '.join(sorted(_MANIFEST))}, missing: "
            f"{', '.join(missing)}; freeze it again"
        )
    return dict(manifest)
