"""CPU milliseconds of GMCNet for one pair, and pairs per second in training, on one thread.

    OMP_NUM_THREADS=1 python benchmarks/network_speed.py --neighbors 5 20 64 --sizes 768 2048

A pair is two samples of the demo object (no data needed), cropped by one far viewpoint. Its time is
that of the whole call, from points to pose: normals, feature graphs, network, matching. "graphs" is
the share of what is not learned. Training is forward, backward and the optimizer's step, with the
paper's loss. Weights are random, which changes no time. Medians, after a warm-up.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from fullturn.data.motion import ball_translation, uniform_rotation
from fullturn.data.perturb import crop_nearest, far_viewpoint
from fullturn.data.procedural import demo_object
from fullturn.data.surface import sample_surface
from fullturn.evaluation.layout import NONE, Table, markdown
from fullturn.evaluation.run import machine
from fullturn.geometry.motion import rigid
from fullturn.geometry.rigid import apply
from fullturn.methods.learned.gmcnet import GMCNet
from fullturn.nn.clouds import CloudBatch
from fullturn.nn.config import PRESETS
from fullturn.nn.graphs import build_graphs
from fullturn.training.losses import paper_loss

# Of the authors' code with its CUDA operations replaced, and of the same network with the maps of
# single points before the gathering; one thread of an AVX-512 Xeon.
RELEASED_MS = {
    (5, 768): ("82–90", "46"),
    (5, 2048): ("456–495", "143"),
    (20, 768): ("206–236", "117"),
    (20, 2048): ("777–804", "304"),
    (64, 768): ("625–659", "305"),
    (64, 2048): ("2,510–2,550", "910"),
}
HEADER = ("k", "points", "parameters", "ms", "encoder", "graphs", "restructured", "released")


def pairs(count: int, points: int, *, seed: int) -> tuple[CloudBatch, CloudBatch, torch.Tensor]:
    """Sources, targets, and the poses between them."""
    rng = np.random.default_rng(seed)
    poses = [
        torch.from_numpy(rigid(uniform_rotation(rng), ball_translation(rng, max_length=1.0)))
        for _ in range(count)
    ]
    sources, targets = [], []
    for T_target_source in poses:
        viewpoint = far_viewpoint(rng)
        source, target = (
            torch.from_numpy(
                crop_nearest(
                    sample_surface(demo_object(), points * 4 // 3, rng), viewpoint, keep=points
                )
            )
            for _ in range(2)
        )
        sources.append(source.float())
        targets.append(apply(T_target_source, target).float())
    return CloudBatch.collate(sources), CloudBatch.collate(targets), torch.stack(poses).float()


def inference(neighbors: int, points: int, *, repetitions: int) -> tuple[str, ...]:
    """One row of the table: one pair, from points to pose."""
    config = replace(PRESETS["clean"], neighbors=(neighbors,) * 3)
    net = GMCNet(config).eval()
    source, target, _ = pairs(1, points, seed=0)
    both = CloudBatch.join([source, target])
    with torch.no_grad():
        whole = milliseconds(lambda: net(source, target), repetitions)
        encoder = milliseconds(lambda: net.encoder(both), repetitions)
        graphs = milliseconds(lambda: build_graphs(both, config), repetitions)
    released, restructured = RELEASED_MS.get((neighbors, points), (NONE, NONE))
    count = sum(value.numel() for value in net.parameters())
    times = [f"{ms:.0f}" for ms in (whole, encoder, graphs)]
    return (str(neighbors), f"{points:,}", f"{count:,}", *times, restructured, released)


def training(neighbors: int, points: int, *, batch: int, repetitions: int) -> float:
    """Pairs per CPU second, data excluded."""
    net = GMCNet(replace(PRESETS["clean"], neighbors=(neighbors,) * 3)).train()
    optimizer = torch.optim.Adam(net.parameters(), lr=1e-4)
    source, target, T_true = pairs(batch, points, seed=0)

    def step() -> None:
        optimizer.zero_grad()
        paper_loss(net(source, target), source, target, T_true, cycle=False).backward()
        optimizer.step()

    return 1000.0 * batch / milliseconds(step, repetitions)


def milliseconds(work: Callable[[], object], repetitions: int) -> float:
    """Median CPU time of a call."""
    work()
    times = []
    for _ in range(repetitions):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return 1000.0 * float(np.median(times))


def main() -> None:
    """Print the table, then the line on training."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--neighbors", type=int, nargs="+", default=[5, 20, 64])
    parser.add_argument("--sizes", type=int, nargs="+", default=[768, 2048])
    parser.add_argument("--repetitions", type=int, default=7)
    parser.add_argument("--batch", type=int, default=16, help="pairs in a training step; 0: none")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    repetitions = arguments.repetitions
    rows = [
        inference(k, n, repetitions=repetitions)
        for k in arguments.neighbors
        for n in arguments.sizes
    ]
    heads = tuple((head,) for head in HEADER)
    print(f"{machine()['processor']}, torch {torch.__version__}, one thread\n")
    print(markdown(Table("network-speed", "Speed of the network", heads, tuple(rows))))
    if arguments.batch:
        k, n = arguments.neighbors[0], arguments.sizes[0]
        rate = training(k, n, batch=arguments.batch, repetitions=max(1, repetitions // 2))
        print(f"training, k = {k}, {n:,} points, batch {arguments.batch}: {rate:.1f} pairs/CPU s")


if __name__ == "__main__":
    main()
