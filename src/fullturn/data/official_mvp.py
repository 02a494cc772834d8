"""MVP-RG as it was published: the authors' HDF5 files of training and test pairs."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from fullturn.data.hdf5 import (
    check_floats,
    check_labels,
    check_rigid,
    open_hdf5,
    read_arrays,
)
from fullturn.data.mvp_rg import group_name
from fullturn.data.pair import Pair
from fullturn.data.pair_set import PairSet
from fullturn.data.provenance import sha256_of_file
from fullturn.errors import ReadError

MVP_CLASSES = (  # in the order of their labels, 0 to 15
    "airplane", "cabinet", "car", "chair", "lamp", "sofa", "table", "watercraft",
    "bed", "bench", "bookshelf", "bus", "guitar", "motorbike", "pistol", "skateboard",
)  # fmt: skip
MVP_LICENSE = "ShapeNet's own terms, by way of MVP: non-commercial research"

_TEST_CLOUDS = ("rotated_src", "rotated_tgt")
_TRAIN_CLOUDS = ("src", "tgt")
_TRAIN_KEYS = (*_TRAIN_CLOUDS, "match_level")
_TEST_KEYS = (*_TEST_CLOUDS, "transforms", "rot_level", "match_level")
_LABELS = ("cat_labels", "cat_label")  # the files, and the words that came with them
_CONSISTENT = 1e-3  # of products of matrices in single precision


class OfficialMvp(PairSet):
    """The pairs of MVP_Test_RG.h5 or MVP_Train_RG.h5, told apart by their keys.

    Test: `rotated_src`, `rotated_tgt` (N, n, 3), `transforms` (N, 4, 4), which takes the former to
    the frame of the latter, `rot_level` (0: within 45°, 1: any rotation), `match_level` (1: more
    of the points have a partner), `cat_labels` (N,). Where `pose_src` and `pose_tgt` are there,
    transforms = pose_tgt · pose_src⁻¹ is checked.

    Training: `src`, `tgt`, `complete` (N, n, 3) in the frame of the object, `match_level`,
    `cat_labels`. The true pose of these is the identity: whoever trains moves the clouds. Pairs
    whose motion isn't known count as unrotated in their group.

    The clouds are shuffled by (seed, number of the pair), so that no order tells the matches. The
    group of a pair is that of the sets that we build (`mvp_rg.group_name`).

    Raises:
        ReadError: other keys or shapes, transforms that aren't rigid or contradict the poses, or
            MVP_ExtraTest_RG.h5, whose poses were never published.
    """

    def __init__(self, path: str | Path, *, seed: int = 0) -> None:
        self._path, self._seed = Path(path), seed
        found = _keys(self._path)
        self._split = _split_of(self._path, found)
        label_key = next((key for key in _LABELS if key in found), _LABELS[0])
        is_test = self._split == "test"
        keys = _TEST_KEYS if is_test else _TRAIN_KEYS
        arrays = read_arrays(self._path, (*keys, label_key))
        clouds = _TEST_CLOUDS if is_test else _TRAIN_CLOUDS
        for key in clouds:
            check_floats(self._path, key, arrays[key], (None, None, 3))
        self._source, self._target = (arrays[key] for key in clouds)
        n = len(self._source)
        self._label = check_labels(self._path, arrays[label_key].ravel(), list(MVP_CLASSES))
        self._match_level = _levels(self._path, "match_level", arrays["match_level"], n)
        self._rotation_level = np.zeros(n, dtype=np.int64)
        self._transforms = np.tile(np.eye(4), (n, 1, 1))
        if is_test:
            self._rotation_level = _levels(self._path, "rot_level", arrays["rot_level"], n)
            check_floats(self._path, "transforms", arrays["transforms"], (n, 4, 4))
            self._transforms = arrays["transforms"].astype(np.float64)
            check_rigid(self._path, self._transforms)
            if {"pose_src", "pose_tgt"} <= found:
                _check_poses(self._path, self._transforms)
        if not n == len(self._target) == len(self._label):
            raise ReadError(
                f"{path}: expected {n} targets and labels, one a source, found "
                f"{len(self._target)} and {len(self._label)}; it is a file of another kind"
            )
        # The published numbers are for the test pairs.
        self.name = "mvp-rg" if is_test else "mvp-rg/train"

    @cached_property
    def description(self) -> dict[str, Any]:
        return {
            "kind": "published pairs of MVP-RG",
            "file": self._path.name,
            "sha256": sha256_of_file(self._path),
            "part": self._split,
            "seed": self._seed,
            "count": len(self),
            "license": MVP_LICENSE,
        }

    def __len__(self) -> int:
        return len(self._source)

    def pair(self, index: int) -> Pair:
        self._check_index(index)
        rng = np.random.default_rng([self._seed, index])
        source, target = (
            cloud[index][rng.permutation(cloud.shape[1])].astype(np.float64)
            for cloud in (self._source, self._target)
        )
        name = f"{MVP_CLASSES[self._label[index]]}_{index:05d}"
        return Pair(source, target, self._transforms[index].copy(), name)

    def group(self, index: int) -> str:
        self._check_index(index)
        return group_name(int(self._match_level[index]), int(self._rotation_level[index]))


def is_mvp_file(path: Path) -> bool:
    """Whether an HDF5 file has the clouds of MVP-RG; its poses may still be missing.

    Raises:
        ReadError: it can't be read.
    """
    found = _keys(path)
    return found >= set(_TEST_CLOUDS) or found >= {*_TRAIN_CLOUDS, "complete"}


def _keys(path: Path) -> set[str]:
    with open_hdf5(path) as file:
        return set(file)


def _split_of(path: Path, found: set[str]) -> str:
    if found >= {*_TRAIN_CLOUDS, "complete"} and not found & set(_TEST_CLOUDS):
        return "train"
    if found >= set(_TEST_CLOUDS) and "transforms" not in found:
        raise ReadError(
            f"{path}: expected the key transforms beside rotated_src and rotated_tgt, there are: "
            f"{', '.join(sorted(found))}; the extra test set was published without its poses: use "
            "MVP_Test_RG.h5"
        )
    return "test"


def _levels(path: Path, key: str, levels: np.ndarray, count: int) -> np.ndarray:
    flat = levels.ravel()
    if flat.shape != (count,) or not np.isin(flat, (0, 1)).all():
        raise ReadError(
            f"{path}: expected {key} as {count} values 0 or 1, found {levels.dtype} of shape "
            f"{levels.shape} with the values {sorted(set(flat.tolist()))[:5]}; "
            "it is a file of another kind"
        )
    return flat.astype(np.int64)


def _check_poses(path: Path, transforms: Float[np.ndarray, "n 4 4"]) -> None:
    """That transforms = pose_tgt · pose_src⁻¹, so that the direction is the one that we think."""
    poses = read_arrays(path, ("pose_src", "pose_tgt"))
    for key, pose in poses.items():
        check_floats(path, key, pose, transforms.shape)
        check_rigid(path, pose.astype(np.float64))
    pose_src, pose_tgt = (poses[key].astype(np.float64) for key in ("pose_src", "pose_tgt"))
    off = np.abs(pose_tgt @ np.linalg.inv(pose_src) - transforms).max(axis=(1, 2))
    if off.max(initial=0.0) > _CONSISTENT:
        worst = int(off.argmax())
        raise ReadError(
            f"{path}: expected transforms = pose_tgt · pose_src⁻¹, number {worst} is off by "
            f"{off[worst]:.2g}; the file has another convention or is damaged: download it again"
        )
