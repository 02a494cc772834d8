"""Fit the verdict: which finalist is right, and is any of them?

    python benchmarks/fit_verdict.py collect --out runs/verdict --count 4000 [--data DIR]
    python benchmarks/fit_verdict.py fit --out runs/verdict

`collect` makes pairs of many kinds (one sampling or two, noise or none, half-space and plane crops,
virtual scans, few and many points, unrelated shapes) from generated shapes and, with --data, from
the freely licensed meshes of a mesh pack; it runs the search and stores what verification measured
of each finalist. It resumes where it stopped. `fit` trains on 80 % of the shapes, reports
calibration on the rest, and writes the weights into the package.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch
from safetensors.torch import save_file
from torch import Tensor

from fullturn.data.pair import Pair
from fullturn.data.protocols import PROTOCOLS, make_pair
from fullturn.data.scan import scan_pair
from fullturn.data.shapes import MeshPack, MeshSource, ProceduralShapes
from fullturn.data.solids import to_unit_ball
from fullturn.errors import FullturnError
from fullturn.evaluation.metrics import expected_calibration_error
from fullturn.geometry.cloud import Cloud
from fullturn.normalize import normalization_of
from fullturn.pose.search import find_finalists
from fullturn.pose.verdict import (
    VerdictWeights,
    log_probabilities,
    same_pose,
    verdict_inputs,
)
from fullturn.pose.verify import FEATURES

FREE_SOURCES = ("sweethome3d", "gazebo", "bullet_random")
KINDS = {  # name: share of the pairs
    "noisy": 0.15,
    "clean": 0.05,
    "noisy-resampled": 0.18,
    "clean-resampled": 0.08,
    "plane": 0.20,
    "scan": 0.22,
    "unrelated": 0.12,
}


def draw_pair(shapes: list[MeshSource], seed: int, number: int) -> tuple[Pair, str, int]:
    """Pair `number`: its kind and the shape that decides on training or test."""
    rng = np.random.default_rng([seed, number])
    source = shapes[int(rng.integers(len(shapes)))]
    index = int(rng.integers(len(source)))
    kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    if kind != "unrelated":
        return _draw(source, index, kind, rng), kind, index
    kinds = [k for k in KINDS if k != "unrelated"]
    first = _draw(source, index, str(rng.choice(kinds)), rng)
    other = (index + 1 + int(rng.integers(len(source) - 1))) % len(source)
    second = _draw(source, other, str(rng.choice(kinds)), rng)
    unrelated = dataclasses.replace(
        first, target=second.target, target_viewpoint=second.target_viewpoint
    )
    return unrelated, kind, index


def _draw(source: MeshSource, index: int, kind: str, rng: np.random.Generator) -> Pair:
    if kind == "scan":
        mesh = to_unit_ball(source.raw_mesh(index))
        return scan_pair(
            mesh,
            rng,
            points=int(rng.integers(500, 3000))
            if rng.random() < 0.85
            else int(rng.integers(60, 500)),
            min_overlap=float(rng.uniform(0.2, 0.7)),
            noise_sigma=float(rng.choice([0.0, 0.002, 0.005, 0.01])),
        )
    sigma = float(rng.choice([0.005, 0.01, 0.01, 0.015]))
    few = int(np.exp(rng.uniform(np.log(12), np.log(400))))
    if kind == "plane":
        protocol = dataclasses.replace(
            PROTOCOLS["geotransformer/180"],
            kept_share=float(rng.uniform(0.5, 0.8)),
            cloud_points=int(rng.integers(300, 800)) if rng.random() < 0.85 else few,
            noise_sigma=sigma if rng.random() < 0.8 else 0.0,
        )
    else:
        points = int(rng.choice([few, 512, 1024, 1024, 1024, 2048]))
        protocol = dataclasses.replace(
            PROTOCOLS[f"modelnet40/{kind}/180"],
            sample_points=points,
            cloud_points=points * 3 // 4,
            noise_sigma=sigma if kind.startswith("noisy") else 0.0,
        )
    return make_pair(protocol, source, index, rng=rng)


def normalized(pair: Pair, *, viewpoints: bool) -> tuple[Cloud, Cloud, Tensor]:
    """The two clouds as a method sees them, and the true pose between them."""
    frame = normalization_of(pair.source, pair.target)

    def cloud(points: np.ndarray, center: np.ndarray, viewpoint: np.ndarray | None) -> Cloud:
        eye = None if viewpoint is None or not viewpoints else (viewpoint - center) / frame.length
        return Cloud(
            torch.from_numpy((points - center) / frame.length),
            None if eye is None else torch.from_numpy(eye),
        )

    T = torch.from_numpy(pair.T_target_source.copy())
    c, d = torch.from_numpy(frame.source_center), torch.from_numpy(frame.target_center)
    T[:3, 3] = (T[:3, :3] @ c + T[:3, 3] - d) / frame.length
    return (
        cloud(pair.source, frame.source_center, pair.source_viewpoint),
        cloud(pair.target, frame.target_center, pair.target_viewpoint),
        T,
    )


def collect(args: argparse.Namespace) -> None:
    torch.set_num_threads(1)
    shapes: list[MeshSource] = [ProceduralShapes(100_000, seed=args.seed)]
    if args.data:
        shapes.append(
            MeshPack(Path(args.data) / "meshes_open.npz", split="train", sources=FREE_SOURCES)
        )
    args.out.mkdir(parents=True, exist_ok=True)
    for first in range(args.first, args.count, args.shard):
        path = args.out / f"finalists-{first:06d}.pt"
        if path.exists():
            continue
        rows = []
        for number in range(first, min(first + args.shard, args.count)):
            try:
                pair, kind, shape = draw_pair(shapes, args.seed, number)
                source, target, T_true = normalized(pair, viewpoints=number % 2 == 0)
                found = find_finalists(source, target)
            except FullturnError as error:
                print(number, type(error).__name__, error, flush=True)
                continue
            rows.append(
                {
                    "kind": kind,
                    "shape": shape,
                    "T": found.T_target_source.float(),
                    "T_true": None if kind == "unrelated" else T_true.float(),
                    "features": found.features,
                    "spacing": found.spacing,
                }
            )
        torch.save(rows, path)
        print(path.name, len(rows), flush=True)


@dataclasses.dataclass(frozen=True, eq=False)
class Table:
    """All collected pairs, padded to the largest number of finalists."""

    features: Tensor  # (pairs, k, f)
    present: Tensor  # (pairs, k)
    right: Tensor  # (pairs, k): within the tolerance of the truth
    same: Tensor  # (pairs, k, k): within the tolerance of one another
    kind: np.ndarray
    shape: np.ndarray


def load_table(folder: Path) -> Table:
    rows = [row for f in sorted(folder.glob("*.pt")) for row in torch.load(f, weights_only=False)]
    k = max(len(row["features"]) for row in rows)
    n, width = len(rows), len(FEATURES)
    features = torch.zeros(n, k, width, dtype=torch.float64)
    present, right = torch.zeros(n, k, dtype=torch.bool), torch.zeros(n, k, dtype=torch.bool)
    same = torch.zeros(n, k, k, dtype=torch.bool)
    for i, row in enumerate(rows):
        count = len(row["features"])
        features[i, :count] = row["features"]
        present[i, :count] = True
        same[i, :count, :count] = same_pose(row["T"], row["T"])
        if row["T_true"] is not None:
            right[i, :count] = same_pose(row["T"], row["T_true"][None])[:, 0]
    return Table(
        features,
        present,
        right,
        same,
        np.array([row["kind"] for row in rows]),
        np.array([row["shape"] for row in rows]),
    )


def fit(args: argparse.Namespace) -> None:
    table = load_table(args.out)
    rng = np.random.default_rng(args.seed)
    shapes = np.unique(table.shape)
    held_out = torch.from_numpy(
        np.isin(table.shape, rng.choice(shapes, len(shapes) // 5, replace=False))
    )
    inputs = verdict_inputs(table.features, table.present)
    of_train = inputs[~held_out][table.present[~held_out]]
    mean, deviation = of_train.mean(0), of_train.std(0) + 1e-6
    generator = torch.Generator().manual_seed(args.seed)
    width = inputs.shape[-1]
    hidden = torch.randn(width, args.hidden, generator=generator, dtype=torch.float64)
    parameters = [
        (hidden / width**0.5).requires_grad_(),
        torch.zeros(args.hidden, dtype=torch.float64, requires_grad=True),
        torch.zeros(args.hidden, dtype=torch.float64, requires_grad=True),
        torch.zeros((), dtype=torch.float64, requires_grad=True),
    ]

    def weights() -> VerdictWeights:
        return VerdictWeights(mean, deviation, *parameters)

    def loss(rows: Tensor) -> Tensor:
        log_p = log_probabilities(inputs[rows], weights(), table.present[rows])
        none_right = ~table.right[rows].any(1, keepdim=True)
        right = torch.cat([table.right[rows], none_right], 1)
        return -torch.logsumexp(log_p.masked_fill(~right, -1e9), 1).mean()

    train = torch.nonzero(~held_out)[:, 0]
    test = torch.nonzero(held_out)[:, 0]
    optimizer = torch.optim.AdamW(parameters, lr=5e-3, weight_decay=args.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, args.steps)
    for step in range(args.steps):
        rows = train[torch.randperm(len(train), generator=generator)[:512]]
        optimizer.zero_grad()
        value = loss(rows)
        value.backward()
        optimizer.step()
        schedule.step()
        if step % 200 == 0:
            with torch.no_grad():
                print(f"step {step}: train {value.item():.3f}, held out {loss(test).item():.3f}")
    final = VerdictWeights(mean, deviation, *(p.detach() for p in parameters))
    report(table, test, inputs, final)
    metadata = {
        "features": json.dumps(FEATURES),
        "card": "see verdict.md beside this file",
    }
    save_file(
        {k: v.contiguous() for k, v in dataclasses.asdict(final).items()},
        args.weights,
        metadata=metadata,
    )
    print("wrote", args.weights)


def report(table: Table, rows: Tensor, inputs: Tensor, weights: VerdictWeights) -> None:
    """Accuracy and calibration of the answer on pairs that the fit has not seen."""
    with torch.no_grad():
        p = log_probabilities(inputs[rows], weights, table.present[rows]).exp()[:, :-1]
    merged = (table.same[rows].double() @ p[..., None])[..., 0]
    best = merged.argmax(1, keepdim=True)
    stated = merged.gather(1, best)[:, 0].numpy()
    right = table.right[rows].gather(1, best)[:, 0].numpy()
    kinds = table.kind[rows.numpy()]
    print(f"{'kind':16s} {'n':>5s} {'any':>6s} {'right':>6s} {'stated':>6s} {'ECE':>6s}")
    for kind in ["all", *KINDS]:
        of = np.ones(len(kinds), bool) if kind == "all" else kinds == kind
        found = table.right[rows].any(1).numpy()[of].mean()
        ece = expected_calibration_error(stated[of], right[of])
        print(
            f"{kind:16s} {of.sum():5d} {found:6.3f} {right[of].mean():6.3f} "
            f"{stated[of].mean():6.3f} {ece:6.3f}"
        )
    unrelated = stated[kinds == "unrelated"]
    print(f"unrelated pairs with at most 0.2: {np.mean(unrelated <= 0.2):.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("step", choices=["collect", "fit"])
    parser.add_argument(
        "--out", type=Path, default=Path("runs/verdict"), help="folder of the pairs"
    )
    parser.add_argument("--count", type=int, default=5000, help="pairs to collect")
    parser.add_argument("--first", type=int, default=0, help="number of the first pair")
    parser.add_argument("--shard", type=int, default=50, help="pairs a file")
    parser.add_argument("--seed", type=int, default=20)
    parser.add_argument("--data", default=os.environ.get("FULLTURN_DATA"), help="mesh packs")
    parser.add_argument("--hidden", type=int, default=16)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--weight-decay", type=float, default=0.05)
    parser.add_argument(
        "--weights", type=Path, default=Path("src/fullturn/weights/verdict.safetensors")
    )
    args = parser.parse_args()
    {"collect": collect, "fit": fit}[args.step](args)


if __name__ == "__main__":
    main()
