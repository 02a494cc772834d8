"""Fit the probabilities of `fullturn locate`: which pose of a model is right, and is any of them?

    python benchmarks/fit_locate.py collect --out runs/locate --count 600 [--data DIR]
    python benchmarks/fit_locate.py fit --out runs/locate

`collect` prepares generated shapes and, with --data, freely licensed meshes of a mesh pack, makes
virtual scans of each (alone, on a support plane, on one with other objects, and of another object),
with the sensor's place known or not, runs the search in every part, and stores what was measured of
each pose. It resumes where it stopped. `fit` trains on four fifths of the shapes, reports
calibration on the rest, and writes the weights into the package.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch
from torch import Tensor

from free_shapes import DATA, free_shapes
from fullturn.data.shapes import MeshSource
from fullturn.evaluation.layout import Table, markdown, plain_header
from fullturn.evaluation.metrics import expected_calibration_error
from fullturn.geometry.extent import center_and_radius
from fullturn.locating.candidates import candidates, grid_of
from fullturn.locating.judge import same_surface
from fullturn.locating.model import PreparedModel, prepare
from fullturn.locating.scene import free_parts, take_apart
from fullturn.locating.search import LocateConfig
from fullturn.locating.verify import FEATURES
from fullturn.normalize import Normalization
from fullturn.pose.grid import NearestGrid
from fullturn.pose.verdict import VerdictWeights, log_probabilities, same_pose, verdict_inputs
from locate_scenes import Scene, scene_of
from logit import collect_shards, fit_logit, held_out_rows, read_rows, steps_parser
from weights_file import write_weights

CARD = """# locate.safetensors

Weights of the probabilities of `fullturn locate` (`fullturn.locating.judge`): one hidden layer over
what is measured of a pose, and a score for "none of them".

- Recipe: `benchmarks/fit_locate.py`, {count} parts of scenes, four fifths of the shapes for the
  fit.
{data}

Scores on the fifth of the shapes that was held out. "Surface": the model's surface lies there,
however a symmetric model is turned. "Pose": within 5° and 5 % of the radius.

{scores}
"""
KINDS = ("alone", "plane", "others", "unrelated")


def rows_of(
    scene: Scene,
    model: PreparedModel,
    grid: NearestGrid,
    *,
    known: bool,
    kind: str,
    shape: str,
) -> list[dict[str, object]]:
    """What was measured in each part of a scene, and which poses are right."""
    center, _ = center_and_radius(scene.points)
    points = torch.from_numpy((scene.points - center) / model.radius)
    eye = torch.from_numpy((scene.viewpoint - center) / model.radius) if known else None
    parts = take_apart(points, eye, model)
    every = torch.ones(len(parts.points), dtype=torch.bool)
    frame = Normalization(model.center.numpy(), center, model.radius)
    T_true = torch.from_numpy(frame.normalize(scene.T_scene_model))[None]
    rows = []
    for members in free_parts(parts, every, model, limit=LocateConfig().parts):
        found = candidates(parts, members, model, grid, LocateConfig())
        T = found.T_scene_model
        surface = same_surface(T.float(), T.float(), model, grid)
        is_there = kind != "unrelated"
        rows.append(
            {
                "kind": kind,
                "shape": shape,
                "features": found.features,
                "same_surface": surface | surface.T,
                "same_pose": same_pose(T, T),
                "surface": same_surface(T.float(), T_true.float(), model, grid)[:, 0] & is_there,
                "pose": same_pose(T, T_true)[:, 0] & is_there,
            }
        )
    return rows


def collect(args: argparse.Namespace) -> None:
    sources = free_shapes(args.seed, args.data)
    collect_shards(args, "parts", lambda number: part_rows(sources, args.seed, number))


def part_rows(sources: list[MeshSource], seed: int, number: int) -> Iterator[dict[str, object]]:
    """What was measured of each part of the scenes of one model."""
    rng = np.random.default_rng([seed, number])
    source = sources[number % len(sources)]
    meshes = [source.mesh(int(i)) for i in rng.integers(len(source), size=3)]
    model = prepare(meshes[0])
    grid = grid_of(model)
    for kind in KINDS:
        if kind == "unrelated" and rng.random() < 0.5:
            continue
        scanned = meshes[1] if kind == "unrelated" else meshes[0]
        others = meshes[1 : 2 + rng.integers(2)] if kind == "others" else []
        plane = kind in ("plane", "others") or (kind == "unrelated" and number % 4 == 0)
        scene = scene_of(scanned, rng, plane=plane, others=others)
        if scene is None:
            continue
        known = bool(rng.random() < 0.5)
        yield from rows_of(scene, model, grid, known=known, kind=kind, shape=f"{number}")


@dataclasses.dataclass(frozen=True, eq=False)
class Collected:
    """All collected parts, padded to the largest number of poses."""

    features: Tensor  # (parts, k, f)
    present: Tensor  # (parts, k)
    right: dict[str, Tensor]  # (parts, k), by "surface" and "pose"
    same: dict[str, Tensor]  # (parts, k, k), likewise
    kind: np.ndarray
    shape: np.ndarray


def load_table(folder: Path) -> Collected:
    rows = list(read_rows(folder))
    k = max(len(row["features"]) for row in rows)
    n = len(rows)
    features = torch.zeros(n, k, len(FEATURES), dtype=torch.float64)
    present = torch.zeros(n, k, dtype=torch.bool)
    right = {name: torch.zeros(n, k, dtype=torch.bool) for name in ("surface", "pose")}
    same = {name: torch.zeros(n, k, k, dtype=torch.bool) for name in right}
    for i, row in enumerate(rows):
        count = len(row["features"])
        features[i, :count] = row["features"]
        present[i, :count] = True
        for name in right:
            right[name][i, :count] = row[name]
            same[name][i, :count, :count] = row[f"same_{name}"]
    return Collected(
        features,
        present,
        right,
        same,
        np.array([row["kind"] for row in rows]),
        np.array([row["shape"] for row in rows]),
    )


def fit(args: argparse.Namespace) -> None:
    table = load_table(args.out)
    held_out = held_out_rows(table.shape, np.random.default_rng(args.seed))
    inputs = verdict_inputs(table.features, table.present)

    def loss(log_p: Tensor, rows: Tensor) -> Tensor:
        surface, pose = table.right["surface"][rows], table.right["pose"][rows]
        none = ~surface.any(1, keepdim=True)
        either = torch.logsumexp(log_p.masked_fill(~torch.cat([surface, none], 1), -1e9), 1)
        # Where the true pose was found: that it is the one, given that the surface lies there.
        one = torch.logsumexp(log_p[:, :-1].masked_fill(~pose, -1e9), 1)
        return -(either + torch.where(pose.any(1), one - either, 0.0)).mean()

    weights = fit_logit(
        inputs,
        table.present,
        held_out,
        loss,
        hidden=args.hidden,
        steps=args.steps,
        weight_decay=args.weight_decay,
        seed=args.seed,
    )
    scores = report(table, torch.nonzero(held_out)[:, 0], inputs, weights)
    print(scores)
    card = CARD.format(count=len(table.kind), data=DATA, scores=scores)
    write_weights(vars(weights), args.weights, metadata={"features": FEATURES}, card=card)


def report(table: Collected, rows: Tensor, inputs: Tensor, weights: VerdictWeights) -> str:
    """Accuracy and calibration of the answers on shapes that the fit has not seen, as a table."""
    with torch.no_grad():
        p = log_probabilities(inputs[rows], weights, table.present[rows]).exp()[:, :-1]
    total = (table.same["surface"][rows].double() @ p[..., None])[..., 0]
    own = (table.same["pose"][rows].double() @ p[..., None])[..., 0]
    best = (total + 1e-3 * own).argmax(1, keepdim=True)
    kinds = table.kind[rows.numpy()]
    cells = []
    for kind in ("all", *KINDS):
        of = np.ones(len(kinds), bool) if kind == "all" else kinds == kind
        line = [kind, str(of.sum())]
        for name, summed in (("surface", total), ("pose", own)):
            right = table.right[name][rows]
            found = right.any(1).numpy()[of]
            stated = summed.gather(1, best)[:, 0].clamp(0, 1).numpy()[of]
            correct = right.gather(1, best)[:, 0].numpy()[of]
            ece = expected_calibration_error(stated, correct)
            line += [f"{x:.3f}" for x in (found.mean(), correct.mean(), stated.mean(), ece)]
        cells.append(tuple(line))
    names = ("among the poses", "answer right", "probability", "ECE")
    header = ["scenes", "parts", *(f"{name}: {n}" for name in ("surface", "pose") for n in names)]
    return markdown(Table("locate", "Locate", plain_header(header), tuple(cells)))


def main() -> None:
    parser = steps_parser(__doc__, "locate", collected="shapes", count=600, shard=20, seed=21)
    parser.set_defaults(hidden=16, steps=800, weight_decay=0.05)
    args = parser.parse_args()
    {"collect": collect, "fit": fit}[args.step](args)


if __name__ == "__main__":
    main()
