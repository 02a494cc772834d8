"""ModelNet40 as it was published: the HDF5 shapes, and the authors' test pairs of GMCNet."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fullturn.data.categories import MODELNET40_CLASSES, SEEN_CLASSES
from fullturn.data.hdf5 import check_floats, check_labels, check_rigid, read_arrays
from fullturn.data.pair import Pair
from fullturn.data.pair_set import PairSet
from fullturn.data.provenance import sha256_of_file, sha256_of_files
from fullturn.data.stored import MODELNET40_LICENSE, StoredPoints
from fullturn.errors import InputError, ReadError
from fullturn.geometry.motion import rotation_angle_deg

_ANGLE_SLACK_DEG = 0.01  # the transforms are stored in single precision


class ModelNet40Hdf5(StoredPoints):
    """Stored shapes of HDF5 files with the keys `data` (N, n, 3) and `label` (N,) or (N, 1).

    `path` is the folder `modelnet40_ply_hdf5_2048`, of which all files of `split` ("train" or
    "test") are read in order, with the class names of its shape_names.txt, or one such file, as
    the training file that was released with GMCNet. Names are class and number.
    """

    def __init__(self, path: str | Path, *, split: str = "test") -> None:
        place = Path(path)
        if split not in ("train", "test"):
            raise InputError(f"expected the split train or test of {path}, got {split!r}; choose")
        self._files, self._root, self._split = [place], place.parent, None
        classes = list(MODELNET40_CLASSES)
        if place.is_dir():
            self._root, self._split = place, split
            self._files = sorted(place.glob(f"ply_data_{split}*.h5"))
            classes = _class_names(place / "shape_names.txt") or classes
        if not self._files:
            raise ReadError(
                f"expected files ply_data_{split}*.h5 in {path}, found none; check the folder"
            )
        read = [read_arrays(file, ("data", "label")) for file in self._files]
        for file, arrays in zip(self._files, read, strict=True):
            check_floats(file, "data", arrays["data"], (len(arrays["label"]), None, 3))
        points = np.concatenate([arrays["data"] for arrays in read])
        label = check_labels(
            self._root, np.concatenate([a["label"].ravel() for a in read]), classes
        )
        names = [f"{classes[k]}_{number:05d}" for number, k in enumerate(label)]
        super().__init__(points, names, [classes[k] for k in label])

    @cached_property
    def description(self) -> dict[str, Any]:
        return {
            "kind": "ModelNet40, HDF5",
            "file": self._root.resolve().name if self._split else self._files[0].name,
            "sha256": sha256_of_files(self._files, root=self._root)
            if self._split
            else sha256_of_file(self._files[0]),
            "part": self._split,
            "count": len(self),
            "license": MODELNET40_LICENSE,
        }


class OfficialModelNet40(PairSet):
    """The test pairs that the authors of GMCNet released, one HDF5 file for each range of angles.

    Keys: `label` (N,) or (N, 1); `transforms` (N, 4, 4), target ≈ T · source; clouds
    `{partial,complete}_{src,tgt}_{clean,noise}` (N, n, 3), of which the first 768 (partial) or
    1,024 (complete) points count. They are shuffled by (seed, number of the pair): the released
    order gives the matches away. `unseen`: only the last 20 classes.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        noisy: bool,
        partial: bool = True,
        unseen: bool = False,
        seed: int = 0,
    ) -> None:
        self._path, self._seed = Path(path), seed
        self._rules = {"noisy": noisy, "partial": partial, "unseen": unseen}
        extent, noise = "partial" if partial else "complete", "noise" if noisy else "clean"
        keys = [f"{extent}_{side}_{noise}" for side in ("src", "tgt")]
        count = 768 if partial else 1024
        arrays = read_arrays(
            self._path, ("label", "transforms", *keys), first=dict.fromkeys(keys, count)
        )
        total = arrays["label"].size
        check_floats(self._path, "transforms", arrays["transforms"], (total, 4, 4))
        for key in keys:
            check_floats(self._path, key, arrays[key], (total, count, 3))
        label = check_labels(self._path, arrays["label"].ravel(), list(MODELNET40_CLASSES))
        transforms = arrays["transforms"].astype(np.float64)
        check_rigid(self._path, transforms)
        keep = label >= len(SEEN_CLASSES) if unseen else np.ones(total, dtype=bool)
        self._number = np.flatnonzero(keep)
        if len(self._number) == 0:
            raise InputError(
                f"expected pairs of the last 20 classes in {path}, found none; read all of them"
            )
        self._source, self._target = (arrays[key][keep] for key in keys)
        self._label, self._transforms = label[keep], transforms[keep]
        # The name of the protocol that these pairs follow: the published numbers are for them.
        kind = ("noisy" if noisy else "clean") + ("" if partial else "-complete")
        largest_deg = float(rotation_angle_deg(transforms[:, :3, :3]).max())
        angle = 45 if largest_deg <= 45.0 + _ANGLE_SLACK_DEG else 180
        self.name = f"modelnet40/{kind}/{angle}" + ("/unseen" if unseen else "")

    @cached_property
    def description(self) -> dict[str, Any]:
        return {
            "kind": "published test pairs of GMCNet",
            "file": self._path.name,
            "sha256": sha256_of_file(self._path),
            **self._rules,
            "seed": self._seed,
            "count": len(self),
            "license": MODELNET40_LICENSE,
        }

    def __len__(self) -> int:
        return len(self._number)

    def pair(self, index: int) -> Pair:
        self._check_index(index)
        number = int(self._number[index])
        rng = np.random.default_rng([self._seed, number])
        source, target = (
            cloud[index][rng.permutation(cloud.shape[1])].astype(np.float64)
            for cloud in (self._source, self._target)
        )
        name = f"{MODELNET40_CLASSES[self._label[index]]}_{number:05d}"
        return Pair(source, target, self._transforms[index].copy(), name)


def _class_names(file: Path) -> list[str]:
    try:
        return file.read_text(encoding="utf-8").split()
    except FileNotFoundError:
        return []
