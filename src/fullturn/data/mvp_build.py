"""Build an MVP-RG set: pairs into shards, shards into a folder, a manifest when all are there."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import trimesh

import fullturn
from fullturn.data.mvp_pair import MadePair, PairMaker, Task
from fullturn.data.mvp_rg import (
    BEGUN,
    FORMAT,
    KIND,
    MANIFEST,
    SPLITS,
    MvpRgConfig,
    hash_of_json,
    read_json,
)
from fullturn.data.mvp_shards import TALLIED, Shard, ShardSummary, shard_bytes, summarize_shard
from fullturn.data.provenance import working_tree_commit
from fullturn.data.raycast import Raycaster
from fullturn.data.shapes import MeshSource
from fullturn.errors import FullturnError, InputError, WriteError, one_line
from fullturn.io.atomic import make_folder, write_atomic

Done = Callable[[int, MadePair | FullturnError], None]
# Calls done(number, work(task)) for every task, in any order.
Runner = Callable[[PairMaker, Iterable[Task], Done], None]


def one_after_the_other(work: PairMaker, tasks: Iterable[Task], done: Done) -> None:
    """The tasks in this process."""
    for number, task in enumerate(tasks):
        done(number, work(task))


def build_mvp_rg(
    shapes: Sequence[MeshSource],
    out: Path,
    config: MvpRgConfig,
    *,
    test_shapes: Sequence[MeshSource] = (),
    run: Runner = one_after_the_other,
    advance: Callable[[int], None] = lambda count: None,
) -> dict[str, Any]:
    """Write the set to the folder `out` and return its manifest; a build that was begun goes on.

    `run` makes the pairs, in worker processes for example: the files are the same, to the byte, for
    any of them. Shards appear whole or not at all. `advance` is told of finished pairs. Without
    `test_shapes`, a part of `shapes` is kept for testing (`mvp_shapes.split_shapes`).

    Raises:
        InputError: shapes that give no pairs, or a folder with anything else than this very set.
        WriteError: the folder cannot be written; finished shards stay.
    """
    maker = PairMaker(config, shapes, test_shapes)
    plan = _plan(config, shapes, test_shapes)
    begun = _begin(out, plan)
    shards = [
        Shard(file, split, first, count, hash_of_json(plan))
        for split in SPLITS
        for file, first, count in config.shards(split)
    ]
    known = {
        one["file"]: one["sha256"]
        for part in begun.get("splits", {}).values()
        for one in part["shards"]
    }
    summaries = {
        shard: summary
        for shard in shards
        if (summary := summarize_shard(out, shard, sha256=known.get(shard.file))) is not None
    }
    advance(sum(shard.count for shard in summaries))
    _make(maker, out, [shard for shard in shards if shard not in summaries], run, advance)
    for shard in shards:
        if shard not in summaries:
            summary = summarize_shard(out, shard)
            if summary is None:
                raise WriteError(
                    f"expected {out / shard.file} as it was written, found it gone or changed; "
                    "start the same command again"
                )
            summaries[shard] = summary
    manifest = _manifest(begun, {shard: summaries[shard] for shard in shards}, maker)
    _write(out / MANIFEST, _json(manifest))
    (out / BEGUN).unlink(missing_ok=True)
    return manifest


def _make(
    maker: PairMaker,
    out: Path,
    shards: Sequence[Shard],
    run: Runner,
    advance: Callable[[int], None],
) -> None:
    """Make and write these shards."""
    place = [
        (shard, index)
        for shard in shards
        for index in range(shard.first, shard.first + shard.count)
    ]
    waiting: dict[Shard, dict[int, MadePair]] = {shard: {} for shard in shards}

    def done(number: int, made: MadePair | FullturnError) -> None:
        if isinstance(made, FullturnError):
            raise made
        shard, index = place[number]
        waiting[shard][index] = made
        if len(waiting[shard]) == shard.count:
            pairs = waiting.pop(shard)
            in_order = [pairs[index] for index in sorted(pairs)]
            _write(out / shard.file, shard_bytes(shard, in_order))
        advance(1)

    if place:
        run(maker, [Task(shard.split, index) for shard, index in place], done)


def _plan(
    config: MvpRgConfig, shapes: Sequence[MeshSource], test_shapes: Sequence[MeshSource]
) -> dict[str, Any]:
    """All that the pairs depend on, but for the code."""
    triangle = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    plan = {
        "format": FORMAT,
        "fullturn": fullturn.__version__,
        "config": asdict(config),
        "shapes": [source.description for source in shapes],
        "test_shapes": [source.description for source in test_shapes],
        # The two agree but where a ray meets an edge.
        "raycaster": Raycaster(triangle).backend,
    }
    return dict(json.loads(json.dumps(plan)))


def _begin(out: Path, plan: dict[str, Any]) -> dict[str, Any]:
    """What the folder says of the set that was begun in it; an empty one is told of this set."""
    make_folder(out)
    for file in (MANIFEST, BEGUN):
        if (out / file).exists():
            begun = read_json(out / file)
            if begun.get("plan") != plan:
                raise InputError(
                    f"expected an empty folder or one of this very set at {out}, {file} tells of "
                    f"another one ({_difference(begun.get('plan'), plan)}); choose another folder"
                )
            return begun
    if any(not path.name.startswith(".") for path in out.iterdir()):
        raise InputError(
            f"expected an empty folder at {out}, found files that are no part of a set; choose "
            "another folder"
        )
    begun = {"kind": KIND, "format": FORMAT, "plan": plan, "commits": [working_tree_commit()]}
    _write(out / BEGUN, _json(begun))
    return begun


def _difference(old: Any, new: dict[str, Any]) -> str:
    """The first values that differ, by their keys."""
    before, after = dict(_leaves(old)), dict(_leaves(new))
    keys = [key for key in {**before, **after} if before.get(key) != after.get(key)]
    return "; ".join(f"{k}: {before.get(k)} there, {after.get(k)} asked for" for k in keys[:3])


def _leaves(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, list):
        value = dict(enumerate(value))
    if not isinstance(value, dict):
        yield key, value
        return
    for name, part in value.items():
        yield from _leaves(part, f"{key}.{name}" if key else str(name))


def _manifest(
    begun: dict[str, Any], summaries: Mapping[Shard, ShardSummary], maker: PairMaker
) -> dict[str, Any]:
    """What the finished folder holds."""
    commits, commit = list(begun["commits"]), working_tree_commit()
    plan = begun["plan"]
    licenses = {one.get("license") for one in (*plan["shapes"], *plan["test_shapes"])} - {None}
    return {
        "kind": KIND,
        "format": FORMAT,
        "fullturn": fullturn.__version__,
        "commits": commits if commit in commits else [*commits, commit],
        "licenses": sorted(licenses),
        "plan": plan,
        "splits": {
            split: _part(
                {shard: one for shard, one in summaries.items() if shard.split == split},
                len(maker.shapes[split]),
            )
            for split in SPLITS
        },
    }


def _part(summaries: Mapping[Shard, ShardSummary], shapes: int) -> dict[str, Any]:
    found = list(summaries.values())
    return {
        "count": sum(shard.count for shard in summaries),
        "shapes": shapes,
        "shapes_used": len({name for one in found for name in one.names}),
        **{key: _added(one.tallies[key] for one in found) for key in TALLIED},
        "skips": _added(one.skips for one in found),
        "shards": [
            {
                "file": shard.file,
                "sha256": one.sha256,
                "first": shard.first,
                "count": shard.count,
                "skips": _added([one.skips]),
            }
            for shard, one in summaries.items()
        ],
    }


def _added(counters: Iterable[Counter[str]]) -> dict[str, int]:
    return dict(sorted(sum(counters, Counter[str]()).items()))


def _json(content: dict[str, Any]) -> str:
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def _write(path: Path, content: bytes | str) -> None:
    try:
        write_atomic(path, content)
    except WriteError as error:
        raise WriteError(
            f"{one_line(error)}. What is finished stays in {path.parent}: once there is room, the "
            "same command goes on where it was"
        ) from error
