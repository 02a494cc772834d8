"""Real range scans with known poses: the Stanford bunny and dragon, and any folder of that form."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from fullturn.data.motion import ball_translation, uniform_rotation
from fullturn.data.pair import Pair
from fullturn.data.pair_set import PairSet
from fullturn.data.provenance import sha256_of_files
from fullturn.errors import InputError, ReadError
from fullturn.geometry.motion import invert, move, rigid
from fullturn.io.load import load_cloud

OVERLAP_CLASSES = {  # name: least overlap
    "overlap 0.6 and more": 0.6,
    "overlap 0.3 to 0.6": 0.3,
    "overlap 0.1 to 0.3": 0.1,
    "overlap below 0.1": 0.0,
}


@dataclass(frozen=True, eq=False)
class _Object:
    """All scans of one object."""

    name: str
    points: dict[str, Float[np.ndarray, "_ 3"]]  # file name: points in the scanner's frame
    T_world_scan: dict[str, Float[np.ndarray, "4 4"]]
    extent: float  # diagonal of the bounding box of the joined scans


@dataclass(frozen=True)
class _Listed:
    """One line of a pairs.csv."""

    object: int
    source: str
    target: str
    overlap: float  # the smaller of the two shares


class StanfordScans(PairSet):
    """All listed pairs of scans whose overlap is large enough, each cloud under a random motion.

    Below `folder`, each object has a folder with PLY scans, `poses.json` (file name to the 4×4
    T_world_scan) and `pairs.csv` (columns source, target, overlap_min: the smaller share of points
    that the other scan has, too). The motions of pair k depend only on (seed, k) and
    `least_overlap`. The true poses are the alignment that comes with the scans, a reference and
    not exact. The group of a pair is its class of overlap.
    """

    name = "stanford"

    def __init__(self, folder: str | Path, *, seed: int = 0, least_overlap: float = 0.1) -> None:
        self._folder, self._seed, self._least_overlap = Path(folder), seed, least_overlap
        places = sorted(file.parent for file in self._folder.glob("*/poses.json"))
        if not places:
            raise ReadError(
                f"expected folders with poses.json and pairs.csv below {folder}, found none; "
                "check the folder"
            )
        self._objects = [_read_object(place) for place in places]
        self._pairs = [
            line
            for number, place in enumerate(places)
            for line in _read_list(place / "pairs.csv", number, self._objects[number])
            if line.overlap >= least_overlap
        ]
        if not self._pairs:
            raise InputError(
                f"expected pairs with an overlap of {least_overlap} and more below {folder}, "
                "found none; lower least_overlap"
            )

    @cached_property
    def description(self) -> dict[str, Any]:
        files = [
            self._folder / thing.name / file
            for thing in self._objects
            for file in ("poses.json", "pairs.csv", *thing.points)
        ]
        return {
            "kind": "real scans with poses",
            "file": self._folder.resolve().name,
            "sha256": sha256_of_files(files, root=self._folder),
            "objects": [thing.name for thing in self._objects],
            "least_overlap": self._least_overlap,
            "seed": self._seed,
            "count": len(self),
            "license": "Stanford 3D Scanning Repository: credit it; no commercial use without "
            "its permission",
        }

    def __len__(self) -> int:
        return len(self._pairs)

    def pair(self, index: int) -> Pair:
        self._check_index(index)
        line = self._pairs[index]
        thing, source, target = self._objects[line.object], line.source, line.target
        rng = np.random.default_rng([self._seed, index])
        T_source_scan, T_target_scan = (
            rigid(uniform_rotation(rng), ball_translation(rng, max_length=thing.extent))
            for _ in range(2)
        )
        T_scan = invert(thing.T_world_scan[target]) @ thing.T_world_scan[source]
        return Pair(
            move(T_source_scan, thing.points[source]),
            move(T_target_scan, thing.points[target]),
            T_target_scan @ T_scan @ invert(T_source_scan),
            f"{thing.name}/{source}-{target}",
        )

    def group(self, index: int) -> str:
        self._check_index(index)
        overlap = self._pairs[index].overlap
        return next(name for name, least in OVERLAP_CLASSES.items() if overlap >= least)


def _read_object(place: Path) -> _Object:
    poses_file = place / "poses.json"
    try:
        poses = json.loads(poses_file.read_text(encoding="utf-8"))
        T_world_scan = {str(name): np.array(T, dtype=np.float64) for name, T in poses.items()}
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise ReadError(
            f"expected a JSON object of file names and 4×4 poses in {poses_file}: {error}; "
            "check the file"
        ) from error
    if not T_world_scan:
        raise ReadError(f"expected scans and their poses in {poses_file}, found no scan; add some")
    for name, T in T_world_scan.items():
        if T.shape != (4, 4) or not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-4):
            raise ReadError(
                f"expected rigid 4×4 poses in {poses_file}, found another matrix for {name}; "
                "check the file"
            )
    points = {name: load_cloud(place / name).points for name in T_world_scan}
    world = np.concatenate([move(T_world_scan[name], points[name]) for name in points])
    extent = float(np.linalg.norm(np.ptp(world, axis=0)))
    return _Object(place.name, points, T_world_scan, extent)


def _read_list(file: Path, number: int, thing: _Object) -> list[_Listed]:
    try:
        with open(file, newline="", encoding="utf-8") as stream:
            lines = [
                _Listed(number, row["source"], row["target"], float(row["overlap_min"]))
                for row in csv.DictReader(stream)
            ]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ReadError(
            f"expected the columns source, target and overlap_min in {file}: "
            f"{type(error).__name__} {error}; check the file"
        ) from error
    for line in lines:
        if not {line.source, line.target} <= thing.points.keys():
            raise ReadError(
                f"expected scans that {thing.name}/poses.json knows in {file}, found the pair "
                f"{line.source}, {line.target}; check the file"
            )
    return lines
