"""Fit the default method's descriptor network (`fullturn.nn.surface`).

    python benchmarks/fit_descriptor.py collect --out runs/descriptor --count 9000 [--data DIR]
    python benchmarks/fit_descriptor.py fit --out runs/descriptor --epochs 8

`collect` makes pairs of many kinds (`fullturn.data.mixture`) of generated shapes and, with --data,
of the freely licensed meshes of a mesh pack, and stores their coarse levels, as the search sees
them. `fit` trains on all but the last pairs, which it validates on, and writes the weights into the
package. Both go on where they were interrupted.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch
from torch import Tensor

from free_shapes import DATA, free_shapes
from fullturn.data.mixture import mixed_pair
from fullturn.data.shapes import MeshSource
from fullturn.features.surface import distances
from fullturn.geometry import rigid
from fullturn.nn.surface import SurfaceNet
from fullturn.normalize import normalized_clouds
from fullturn.pose.search import coarse_and_fine
from logit import collect_shards
from weights_file import write_weights

LEAST_POINTS = 200
SAME, OTHER = 1.5, 4.0  # spacings: a partner, and surely none
TEMPERATURE = 0.07
KEYPOINTS = 400  # of each cloud, other ones in each step
ANCHORS = 256  # of them, whose matches a step looks at
BATCH = 4
VALIDATION = 300  # pairs

CARD = """# descriptor.safetensors

Weights of the default method's descriptor (`fullturn.nn.surface.SurfaceNet`): {parameters:,}
numbers.

- Recipe: `benchmarks/fit_descriptor.py`, {pairs:,} pairs, {epochs} epochs, {minutes:.0f} minutes of
  one core.
{data}

Of the 200 best matches of a pair, the share that is right (within two spacings), on {validation}
pairs that were held out:

{scores}
"""


def collect(args: argparse.Namespace) -> None:
    shapes = free_shapes(args.seed, args.data, meshes=2, stretched=True)
    collect_shards(
        args, f"levels-{args.seed}", lambda number: level_rows(shapes, args.seed, number)
    )


def level_rows(shapes: list[MeshSource], seed: int, number: int) -> list[dict[str, Any]]:
    """A pair as the search sees it, in point spacings; none that can't teach anything."""
    mixed = mixed_pair(shapes, seed=seed, number=number)
    pair = mixed.pair
    if mixed.kind == "unrelated" or min(len(pair.source), len(pair.target)) < LEAST_POINTS:
        return []
    source, target, frame = normalized_clouds(pair.source, pair.target)
    level, _ = coarse_and_fine(source, target)
    T = torch.from_numpy(frame.normalize(pair.T_target_source)).float()
    T[:3, 3] /= level.spacing
    clouds = [
        {"points": one.points / level.spacing, "normals": one.normals, "area": one.area}
        for one in (level.source, level.target)
    ]
    return [{"kind": mixed.kind, "T": T, "clouds": clouds}]


def fit(args: argparse.Namespace) -> None:
    torch.set_num_threads(1)
    rows = [row for f in sorted(args.out.glob("levels-*.pt")) for row in torch.load(f)]
    rows, held_out = rows[:-VALIDATION], rows[-VALIDATION:]
    torch.manual_seed(args.seed)
    network = SurfaceNet()
    with torch.no_grad():
        some = torch.cat([surroundings(network, row["clouds"][0]) for row in rows[:400]])
        network.mean.copy_(some.mean(0))
        network.deviation.copy_(some.std(0) + 1e-3)
    print(f"{len(rows)} pairs, {len(held_out)} held out", flush=True)
    steps = args.epochs * (len(rows) // BATCH)
    optimizer = torch.optim.AdamW(network.parameters(), lr=args.rate, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, args.rate, total_steps=steps + 1)
    state_path = args.out / "fit.ckpt"
    step, seconds = 0, 0.0
    if state_path.exists():
        state = torch.load(state_path)
        network.load_state_dict(state["network"])
        optimizer.load_state_dict(state["optimizer"])
        schedule.load_state_dict(state["schedule"])
        step, seconds = state["step"], state["seconds"]
    begin = time.process_time() - seconds
    total = 0.0
    while step < steps:
        rng = np.random.default_rng([args.seed, step])
        epoch, place = divmod(step * BATCH, len(rows) // BATCH * BATCH)
        order = np.random.default_rng([args.seed, 1 << 20, epoch]).permutation(len(rows))
        losses = [
            value
            for number in order[place : place + BATCH]
            if (value := pair_loss(network, rows[number], rng)) is not None
        ]
        step += 1
        schedule.step()
        if losses:
            optimizer.zero_grad()
            loss = torch.stack(losses).mean()
            loss.backward()
            optimizer.step()
            total += loss.item()
        if step % 250 == 0:
            seconds = time.process_time() - begin
            print(f"step {step} of {steps}: {total / 250:.3f}, {seconds:.0f} s", flush=True)
            total = 0.0
            torch.save(
                {
                    "network": network.state_dict(),
                    "optimizer": optimizer.state_dict(),
                    "schedule": schedule.state_dict(),
                    "step": step,
                    "seconds": seconds,
                },
                state_path,
            )
        if step % 2000 == 0:
            print(scores(network, held_out), flush=True)
    write(network, args, pairs=len(rows), held_out=held_out, minutes=seconds / 60)


def surroundings(network: SurfaceNet, cloud: dict[str, Tensor]) -> Tensor:
    """What the network is told of every point."""
    everyone = torch.arange(len(cloud["points"]))
    distance = distances(cloud["points"], everyone)
    return network.surroundings(**cloud, distance=distance, keypoints=everyone)


def described(
    network: SurfaceNet, cloud: dict[str, Tensor], rng: np.random.Generator
) -> tuple[Tensor, Tensor]:
    """Places and descriptors of random keypoints."""
    some = torch.from_numpy(rng.permutation(len(cloud["points"]))[:KEYPOINTS])
    return cloud["points"][some], network(**cloud, keypoints=some, spacing=1.0)


def pair_loss(network: SurfaceNet, row: dict[str, Any], rng: np.random.Generator) -> Tensor | None:
    """Cross entropy of a keypoint's partners among all keypoints of the other cloud, both ways.

    Points between `SAME` and `OTHER` away from the true place count as neither.
    """
    places, descriptors = zip(*(described(network, one, rng) for one in row["clouds"]), strict=True)
    places = (rigid.apply(row["T"], places[0]), places[1])
    losses = []
    for one in (0, 1):
        anchors = torch.from_numpy(rng.permutation(len(places[one]))[:ANCHORS])
        distance = torch.cdist(places[one][anchors], places[1 - one])
        partner = distance < SAME
        known = partner.any(1)
        if not bool(known.any()):
            continue
        logits = descriptors[one][anchors[known]] @ descriptors[1 - one].T / TEMPERATURE
        partner, distance = partner[known], distance[known]
        among = logits.masked_fill(~partner & (distance < OTHER), -1e4)
        right = logits.masked_fill(~partner, -1e4)
        losses.append((among.logsumexp(1) - right.logsumexp(1)).mean())
    return torch.stack(losses).mean() if losses else None


@torch.no_grad()
def scores(network: SurfaceNet, rows: list[dict[str, Any]]) -> str:
    """The share of right matches among the 200 best, by kind, as a table."""
    shares: dict[str, list[float]] = {"all": []}
    rng = np.random.default_rng(0)
    for row in rows:
        (source, one), (target, other) = (described(network, c, rng) for c in row["clouds"])
        value, index = (one @ other.T).max(1)
        best = value.topk(min(200, len(value))).indices
        there = rigid.apply(row["T"], source[best])
        right = (there - target[index[best]]).norm(dim=-1) < 2.0
        for kind in ("all", row["kind"]):
            shares.setdefault(kind, []).append(float(right.float().mean()))
    lines = [f"| {kind} | {len(v)} | {np.mean(v):.3f} |" for kind, v in shares.items()]
    return "\n".join(["| kind | pairs | right |", "| --- | ---: | ---: |", *lines])


def write(
    network: SurfaceNet,
    args: argparse.Namespace,
    *,
    pairs: int,
    held_out: list[dict[str, Any]],
    minutes: float,
) -> None:
    """The weights and their card."""
    table = scores(network, held_out)
    print(table)
    write_weights(
        network.state_dict(),
        args.weights,
        metadata={"config": asdict(network.config)},
        card=CARD.format(
            parameters=sum(p.numel() for p in network.parameters()),
            pairs=pairs,
            epochs=args.epochs,
            minutes=minutes,
            validation=len(held_out),
            data=DATA,
            scores=table,
        ),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("step", choices=["collect", "fit"])
    parser.add_argument("--out", type=Path, default=Path("runs/descriptor"))
    parser.add_argument("--count", type=int, default=9000, help="pairs to draw")
    parser.add_argument("--first", type=int, default=0, help="number of the first pair")
    parser.add_argument("--shard", type=int, default=250, help="pairs a file")
    parser.add_argument("--seed", type=int, default=30)
    parser.add_argument("--data", default=os.environ.get("FULLTURN_DATA"), help="mesh packs")
    parser.add_argument("--epochs", type=int, default=8)
    parser.add_argument("--rate", type=float, default=3e-3)
    parser.add_argument(
        "--weights", type=Path, default=Path("src/fullturn/weights/descriptor.safetensors")
    )
    args = parser.parse_args()
    {"collect": collect, "fit": fit}[args.step](args)


if __name__ == "__main__":
    main()
