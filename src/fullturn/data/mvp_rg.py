"""Our MVP-RG: what a built set is told by its rules, and its pairs, read from the shards."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fullturn.data.npz import open_npz
from fullturn.data.pair import Pair
from fullturn.data.pair_set import PairSet
from fullturn.data.provenance import sha256_of_file
from fullturn.data.sensor import Sensor
from fullturn.errors import InputError, ReadError

FORMAT = 1
KIND = "fullturn mvp-rg"  # by which a folder of another kind is told
MANIFEST, BEGUN = "manifest.json", "building.json"
SPLITS = ("train", "test")
SHARD_KEYS = (
    "shard", "source", "target", "T_target_source", "source_viewpoint", "target_viewpoint",
    "name", "category", "overlap", "match_level", "rotation_level",
)  # fmt: skip

_MATCHES = ("match low", "match high")
_ROTATIONS = ("within 45°", "any rotation")


@dataclass(frozen=True)
class MvpRgConfig:
    """The rules of a set. Lengths are in radii of the object, whose bounding ball has radius 1."""

    train: int = 6400  # pairs
    test: int = 1200  # pairs
    points: int = 2048  # of each cloud
    views: int = 26  # cameras around each object
    distance: float = 3.0  # of the cameras from its center
    resolution: int = 160  # pixels a side; more where a view shows too little
    min_overlap: float = 0.3  # `scan_overlap` of the two clouds
    high_overlap: float = 0.6  # from here on, match_level is 1, below it 0
    # full: every pair under any rotation. released: four of five within 45°, as in the set that
    # was published.
    rotation: Literal["full", "released"] = "full"
    translation: float = 0.5  # of each cloud, at most
    test_share: float = 0.2  # of the shapes
    shard: int = 200  # pairs a file
    seed: int = 0
    sensor: Sensor = field(default_factory=Sensor)

    def __post_init__(self) -> None:
        wrong = [
            f"{name} {getattr(self, name)!r} ({wanted})"
            for name, wanted, fits in (
                ("train", "0 or more", self.train >= 0),
                ("test", "0 or more, one of train and test more", self.test >= 0),
                ("train", "one of train and test more than 0", self.train or self.test),
                ("points", "3 or more", self.points >= 3),
                ("views", "2 or more", self.views >= 2),
                ("distance", "more than 1, outside of the ball", self.distance > 1.0),
                ("resolution", "8 to 1024", 8 <= self.resolution <= 1024),
                ("min_overlap", "0 to 1", 0.0 <= self.min_overlap <= 1.0),
                ("high_overlap", "0 to 1", 0.0 <= self.high_overlap <= 1.0),
                ("rotation", "full or released", self.rotation in ("full", "released")),
                ("translation", "0 or more", self.translation >= 0.0),
                ("test_share", "between 0 and 1", 0.0 < self.test_share < 1.0),
                ("shard", "1 or more", self.shard >= 1),
                ("seed", "0 or more", self.seed >= 0),
            )
            if not fits
        ]
        if wrong:
            raise InputError(
                f"expected other values of an MVP-RG set than {', '.join(wrong)}; change them"
            )

    def count(self, split: str) -> int:
        """The number of pairs of a split."""
        return self.train if split == "train" else self.test

    def shards(self, split: str) -> list[tuple[str, int, int]]:
        """File name, first pair and number of pairs of each shard.

        >>> MvpRgConfig(train=450, test=0).shards("train")[-1]
        ('train-00002.npz', 400, 50)
        """
        return [
            (f"{split}-{number:05d}.npz", first, min(self.shard, self.count(split) - first))
            for number, first in enumerate(range(0, self.count(split), self.shard))
        ]


def group_name(match_level: int, rotation_level: int) -> str:
    """The class of a pair: match level 1 is the higher overlap, rotation level 0 the smaller turn.

    >>> group_name(1, 0)
    'match high, within 45°'
    """
    return f"{_MATCHES[match_level]}, {_ROTATIONS[rotation_level]}"


class MvpRgPairs(PairSet):
    """The pairs of one split of a folder that `fullturn build mvp-rg` made.

    A shard is read, and its hash checked, when the first of its pairs is asked for; it stays in
    memory, about 50 kB a pair. The group of a pair is `group_name` of its levels.
    """

    manifest: dict[str, Any]

    def __init__(self, path: str | os.PathLike[str], *, split: str = "test") -> None:
        """Raises ReadError where the folder is no finished set, InputError for another split."""
        self._folder, self._split = Path(path), split
        self.manifest = read_manifest(self._folder)
        part = self.manifest["splits"].get(split)
        if part is None or not part["count"]:
            there = [name for name, one in self.manifest["splits"].items() if one["count"]]
            raise InputError(
                f"expected a split out of {', '.join(there)} of {path}, got {split!r}; "
                f"write for example {self._folder.name}:{there[0]}"
            )
        self._count, self._shards = int(part["count"]), part["shards"]
        self._firsts = [int(shard["first"]) for shard in self._shards]
        self._read: dict[int, dict[str, np.ndarray]] = {}
        self.name = "mvp-rg/built" if split == "test" else f"mvp-rg/built-{split}"

    @cached_property
    def description(self) -> dict[str, Any]:
        plan = self.manifest["plan"]
        return {
            "kind": "MVP-RG, built",
            "file": self._folder.resolve().name,
            "sha256": sha256_of_file(self._folder / MANIFEST),
            "part": self._split,
            "seed": plan["config"]["seed"],
            "count": len(self),
            "rules": plan["config"],
            "shapes": plan["shapes"],
            "commit": self.manifest["commits"][-1],
            "license": "; ".join(self.manifest["licenses"]) or None,
        }

    def __len__(self) -> int:
        return self._count

    def pair(self, index: int) -> Pair:
        arrays, row = self._row(index)
        return Pair(
            arrays["source"][row].astype(np.float64),
            arrays["target"][row].astype(np.float64),
            arrays["T_target_source"][row].copy(),
            str(arrays["name"][row]),
            source_viewpoint=arrays["source_viewpoint"][row].copy(),
            target_viewpoint=arrays["target_viewpoint"][row].copy(),
        )

    def group(self, index: int) -> str:
        arrays, row = self._row(index)
        return group_name(int(arrays["match_level"][row]), int(arrays["rotation_level"][row]))

    def facts(self, index: int) -> dict[str, Any]:
        """What else is recorded of a pair: category, overlap, match_level and rotation_level."""
        arrays, row = self._row(index)
        keys = ("category", "overlap", "match_level", "rotation_level")
        return {key: arrays[key][row].item() for key in keys}

    def _row(self, index: int) -> tuple[dict[str, np.ndarray], int]:
        self._check_index(index)
        number = int(np.searchsorted(self._firsts, index, side="right")) - 1
        if number not in self._read:
            shard = self._shards[number]
            path = self._folder / shard["file"]
            found = sha256_of_file(path)
            if found != shard["sha256"]:
                raise ReadError(
                    f"expected {path} with the SHA-256 {shard['sha256']}, found {found}; the file "
                    "was changed or damaged: build the set again, which makes only what is missing"
                )
            self._read[number] = open_npz(path, SHARD_KEYS)
        return self._read[number], index - self._firsts[number]


def is_built(folder: Path) -> bool:
    """Whether a set was built in a folder, or at least begun."""
    return (folder / MANIFEST).exists() or (folder / BEGUN).exists()


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a finished set.

    Raises:
        ReadError: there is none, the set isn't finished, or it is of another kind or format.
    """
    path = folder / MANIFEST
    if not path.exists() and (folder / BEGUN).exists():
        raise ReadError(
            f"expected a finished set in {folder}, found one that is still being built; start the "
            "same `fullturn build mvp-rg` again, it goes on where it was"
        )
    manifest = read_json(path)
    if manifest.get("kind") != KIND or not {"plan", "splits", "commits"} <= manifest.keys():
        raise ReadError(
            f"expected the manifest of a built MVP-RG set in {path}, found another kind of file; "
            "name the folder that `fullturn build mvp-rg` made"
        )
    if manifest["format"] != FORMAT:
        raise ReadError(
            f"{path}: expected format {FORMAT}, found {manifest['format']}; read it with fullturn "
            f"{manifest.get('fullturn')}, or build the set again"
        )
    return manifest


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object from a file.

    Raises:
        ReadError: no such file, or something else in it.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(content, dict):
            raise ValueError("it is something else")
    except (OSError, ValueError) as error:
        raise ReadError(f"expected a JSON object in {path}: {error}; check the file") from error
    return content


def hash_of_json(value: Any) -> str:
    """SHA-256 of a JSON value, the same for every order of the keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
