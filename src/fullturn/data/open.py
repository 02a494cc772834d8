"""Shapes and pairs from what a user names: a file, a folder, a protocol."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from fullturn.data.draw import ProtocolPairs
from fullturn.data.frozen import FrozenPairs
from fullturn.data.mixture import MixedPairs
from fullturn.data.mvp_rg import MvpRgPairs, is_built
from fullturn.data.npz import npz_keys
from fullturn.data.official import ModelNet40Hdf5, OfficialModelNet40
from fullturn.data.official_mvp import OfficialMvp, is_mvp_file
from fullturn.data.pair_set import PairSet
from fullturn.data.protocols import PROTOCOLS
from fullturn.data.shapes import (
    PACK_KEYS,
    MeshFolder,
    MeshPack,
    MeshSource,
    ProceduralShapes,
    ShapeSource,
)
from fullturn.data.stanford import StanfordScans
from fullturn.data.stored import MODELNET_KEYS, ModelNetSubset
from fullturn.errors import InputError, ReadError

DATA_VARIABLE = "FULLTURN_DATA"
_PROCEDURAL_COUNT = 1000
_SHAPES = (
    "FILE.npz[:PART] (a mesh pack, or stored ModelNet40 points), a folder of mesh files, a "
    "modelnet40_ply_hdf5_2048 folder or .h5 file [:train], procedural[:COUNT[:SEED]]"
)
_PAIRS = (
    "a frozen .npz file, a published .h5 file [:clean,complete,unseen], a folder that "
    "`fullturn build mvp-rg` made [:train], or a folder of objects with poses.json and pairs.csv"
)
_OFFICIAL_WORDS = ("noisy", "clean", "partial", "complete", "unseen")


def open_shapes(spec: str) -> ShapeSource:
    """The shapes that a text names.

    `FILE.npz[:PART]`: a mesh pack or stored ModelNet40 points, by its keys; PART is a split of the
    former, a use of the latter. A folder of mesh files; a folder of ModelNet40 HDF5 files, or one
    of these, with `:train` for its training part. `procedural[:COUNT[:SEED]]`: generated objects.
    A relative path that doesn't exist is looked for below the environment variable FULLTURN_DATA.

    >>> len(open_shapes("procedural:20:7"))
    20

    Raises:
        InputError: no such part, or a text of another form.
        ReadError: nothing there, or it can't be read.
    """
    head, *numbers = spec.split(":")
    if head == "procedural":
        return _procedural(spec, numbers)
    path, part = _split_part(spec)
    place = find(path, expected=_SHAPES)
    if place.is_dir() and not any(place.glob("ply_data_*.h5")):
        if part is not None:
            raise InputError(
                f"expected no part after a folder of meshes, got {spec!r}; leave it out"
            )
        return MeshFolder(place)
    if place.is_dir() or place.suffix.lower() in (".h5", ".hdf5"):
        return ModelNet40Hdf5(place, split=part or "test")
    if place.suffix.lower() == ".npz":
        keys = npz_keys(place)
        if keys >= set(MODELNET_KEYS):
            return ModelNetSubset(place) if part is None else ModelNetSubset(place, use=part)
        if keys >= set(PACK_KEYS):
            return MeshPack(place, split=part)
        some = ", ".join(sorted(keys)[:8])
        raise ReadError(
            f"expected a mesh pack (keys {', '.join(PACK_KEYS)}) or stored ModelNet40 points "
            f"(keys {', '.join(MODELNET_KEYS)}) in {place}, found the keys "
            f"{some}{', …' if len(keys) > 8 else ''}; it is a file of another kind"
        )
    raise InputError(f"expected shapes as {_SHAPES}; got {spec!r}; name one of these")


def open_pairs(path: str | Path) -> PairSet:
    """The pairs that a path holds: frozen (.npz), published (.h5), built or scanned (a folder).

    A published file of ModelNet40 is opened as its noisy, partial clouds of all classes;
    `FILE.h5:clean,unseen` chooses others, out of noisy or clean, partial or complete, unseen. A
    published file of MVP-RG has one kind of clouds. Of a folder that `fullturn build mvp-rg` made,
    the test pairs are opened, of `FOLDER:train` those for training.
    A relative path that doesn't exist is looked for below the environment variable FULLTURN_DATA.

    Raises:
        InputError: a file of another kind.
        ReadError: nothing there, or it can't be read.
    """
    name, part = _split_part(str(path))
    place = find(name, expected=_PAIRS)
    if place.suffix.lower() in (".h5", ".hdf5"):
        return OfficialMvp(place) if part is None and is_mvp_file(place) else _official(place, part)
    if place.is_dir() and is_built(place):
        return MvpRgPairs(place, split=part or "test")
    if part is None and place.is_dir():
        return StanfordScans(place)
    if part is None and place.suffix.lower() == ".npz":
        return FrozenPairs(place)
    raise InputError(f"expected pairs as {_PAIRS}; got {str(path)!r}; name one of these")


def protocol_pairs(
    names: Sequence[str], shapes: ShapeSource, *, count: int, seed: int = 0
) -> tuple[list[PairSet], list[str]]:
    """One set per protocol, and one line per protocol that was left out, with the reason.

    "all" among the names stands for every protocol that the shapes can serve; "mixture" is not one
    of them, but `MixedPairs`.

    Raises:
        InputError: an unknown name, or one named outright that the shapes can't serve.
    """
    known = ("all", *PROTOCOLS, MixedPairs.name)
    if not names:
        raise InputError(f"expected at least one protocol out of {', '.join(known)}")
    unknown = sorted(set(names) - set(known))
    if unknown:
        raise InputError(
            f"expected protocols out of {', '.join(known)}; got {', '.join(unknown)}; "
            "choose among these"
        )
    asked = dict.fromkeys(names)
    if "all" in asked:
        asked = {**dict.fromkeys(PROTOCOLS), **asked}
        del asked["all"]
    sets: list[PairSet] = []
    left_out: list[str] = []
    for name in asked:
        try:
            sets.append(_drawn(name, shapes, count=count, seed=seed))
        except InputError as error:
            if name in names or count < 1:
                raise
            left_out.append(str(error))
    if not sets:
        raise InputError(
            "expected shapes that can serve a protocol, got none that do: " + " | ".join(left_out)
        )
    return sets, left_out


def _drawn(name: str, shapes: ShapeSource, *, count: int, seed: int) -> PairSet:
    if name in PROTOCOLS:
        return ProtocolPairs(PROTOCOLS[name], shapes, count=count, seed=seed)
    if not isinstance(shapes, MeshSource):
        raise InputError(f"{name} needs meshes, got stored point samples; pass other shapes")
    return MixedPairs(shapes, count=count, seed=seed)


def find(path: str, *, expected: str) -> Path:
    """The path as it is, or else below the environment variable FULLTURN_DATA.

    Raises:
        ReadError: it is at neither place.
    """
    places = [Path(path)]
    data = os.environ.get(DATA_VARIABLE)
    if data and not places[0].is_absolute():
        places.append(Path(data) / path)
    for place in places:
        if path and place.exists():
            return place
    hint = "" if data else f", or set {DATA_VARIABLE} to the folder that holds it"
    raise ReadError(
        f"expected {expected}; got {path!r}, found nothing at "
        f"{' or '.join(str(place) for place in places)}; check the path{hint}"
    )


def place_of(spec: str | None) -> Path | None:
    """The file or folder that a text for `open_shapes` or `open_pairs` names, if it is there."""
    if spec is None:
        return None
    for path in (spec, _split_part(spec)[0]):
        with suppress(ReadError):
            return find(path, expected=_SHAPES)
    return None


def _split_part(spec: str) -> tuple[str, str | None]:
    """A path and what stands after its last colon, if that is a plain word and no drive's path."""
    head, _, part = spec.rpartition(":")
    if len(head) < 2 or not part or set(part) & set("/\\") or Path(spec).exists():
        return spec, None
    return head, part


def _procedural(spec: str, numbers: list[str]) -> ProceduralShapes:
    if len(numbers) > 2 or not all(text.isdecimal() for text in numbers):
        raise InputError(
            f"expected procedural[:COUNT[:SEED]] with whole numbers, got {spec!r}; "
            "write for example procedural:200:7"
        )
    count, seed = [*(int(text) for text in numbers), *(_PROCEDURAL_COUNT, 0)[len(numbers) :]]
    return ProceduralShapes(count, seed=seed)


def _official(place: Path, part: str | None) -> OfficialModelNet40:
    words = set(part.split(",")) if part else set()
    if not words <= set(_OFFICIAL_WORDS):
        raise InputError(
            f"expected a choice out of {', '.join(_OFFICIAL_WORDS)} after {place.name}:, joined by "
            f"commas; got {part!r}; change it"
        )
    return OfficialModelNet40(
        place,
        noisy="clean" not in words,
        partial="complete" not in words,
        unseen="unseen" in words,
    )
