"""Fit the evidence network and the verdict: which finalist is right, and is any of them?

    python benchmarks/fit_verdict.py collect --out runs/verdict --count 4000 [--data DIR]
    python benchmarks/fit_verdict.py collect --out runs/verdict --dense --first 4000 --count 4800 …
    python benchmarks/fit_verdict.py evidence --out runs/verdict
    python benchmarks/fit_verdict.py fit --out runs/verdict
    python benchmarks/fit_verdict.py collect --out runs/confidence --seed 21 --count 4000 …
    python benchmarks/fit_verdict.py confidence --out runs/confidence

`collect` makes pairs of many kinds (one sampling or two, noise or none, half-space and plane crops,
virtual scans, few and many points, unrelated shapes) from generated shapes and, with --data, from
the freely licensed meshes of a mesh pack; it runs the search and stores what verification measured
of each finalist. It resumes where it stopped. The search looks twice where the verdict of the
package doubts; if that was fit to other features, a first fit needs --once. `evidence` trains the
network that sums up what all points say, `fit` then the verdict, which takes its number as one of
its features: on 80 % of the shapes, with calibration on the rest. `confidence` learns from pairs
that neither has seen, collected with their weights, how far scores can be trusted: on pairs of
their fit, the evidence knows more than it will of others. Each writes its weights into the package.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import os
from collections.abc import Callable
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch
from torch import Tensor

from confidence_fit import fit_confidence
from evidence_fit import evidence_of_all, fit_evidence, split_signals
from free_shapes import DATA, free_shapes
from fullturn.data.mixture import KINDS, mixed_pair
from fullturn.data.motion import axis_angle_rotation
from fullturn.data.pair import Pair
from fullturn.data.shapes import MeshSource
from fullturn.evaluation.layout import Table, markdown, plain_header
from fullturn.evaluation.metrics import expected_calibration_error
from fullturn.geometry.cloud import Cloud
from fullturn.geometry.motion import invert, move, rigid
from fullturn.nn.evidence import load_evidence_net
from fullturn.normalize import normalized_clouds
from fullturn.pose.confidence import confidence_inputs, tempered
from fullturn.pose.decide import find_and_judge
from fullturn.pose.search import Finalists, SearchConfig, find_finalists
from fullturn.pose.verdict import (
    load_weights,
    log_probabilities,
    same_pose,
    verdict_inputs,
)
from fullturn.pose.verify import AGREEMENT, EVIDENCE, FEATURES, FINE
from logit import collect_shards, fit_logit, held_out_rows, read_rows, steps_parser
from weights_file import write_weights

CARD = """# verdict.safetensors

Weights of the verdict between finalists (`fullturn.pose.verdict`): one hidden layer over what
verification measures, and a score for "none of them".

- Recipe: `benchmarks/fit_verdict.py`, {count} pairs, four fifths of the shapes for the fit.
{data}

Scores on the fifth of the shapes that was held out:

{scores}
"""

EVIDENCE_CARD = """# evidence.safetensors

Weights of the network that sums up what all keypoints say of a pose (`fullturn.nn.evidence`);
{parameters:,} numbers.

- Recipe: `benchmarks/fit_verdict.py`, {count} pairs, four fifths of the shapes for the fit; the
  loss of the verdict. Its scores are those of verdict.safetensors.
{data}
"""

CONFIDENCE_CARD = """# confidence.safetensors

Weights of the network that says how far the verdict can be trusted in a pair
(`fullturn.nn.confidence`).

- Recipe: `benchmarks/fit_verdict.py`, {count} pairs that neither the evidence network nor the
  verdict was fit on, four fifths of the shapes for the fit.
{data}

Scores on the fifth of the shapes that was held out, without the network and with it:

{scores}
"""

_AT_ONCE = 4096  # pairs
POINTS = 96  # of each cloud whose signals are kept

WITHOUT_NETWORK = 0.15  # share of the pairs of the fit
# Shapes unlike those of the fit are judged too surely: scores are made smaller by this, which cost
# nothing measurable on `val` meshes of the research pack, and kept every kind's ECE below 0.05.
SOFTENED = 0.9
LIMITED = 0.15  # share of the pairs whose rotation is small, and known to be


def normalized(pair: Pair, *, viewpoints: bool) -> tuple[Cloud, Cloud, Tensor]:
    """The two clouds as a method sees them, and the true pose between them."""
    eyes = (pair.source_viewpoint, pair.target_viewpoint) if viewpoints else (None, None)
    source, target, frame = normalized_clouds(pair.source, pair.target, *eyes)
    return source, target, torch.from_numpy(frame.normalize(pair.T_target_source))


def nearly_aligned(pair: Pair, rng: np.random.Generator) -> Pair:
    """The pair with its source moved, so that a rotation of at most 45° is left."""
    T_target_new = rigid(axis_angle_rotation(rng, max_angle_deg=45.0), np.zeros(3))
    T_new_source = invert(T_target_new) @ pair.T_target_source
    eye = pair.source_viewpoint
    return dataclasses.replace(
        pair,
        source=move(T_new_source, pair.source),
        T_target_source=T_target_new,
        source_viewpoint=None if eye is None else move(T_new_source, eye[None])[0],
    )


def collect(args: argparse.Namespace) -> None:
    shapes = free_shapes(args.seed, args.data, stretched=True)
    stem = "dense" if args.dense else "finalists"
    collect_shards(args, stem, lambda number: finalist_rows(shapes, args, number))


def finalist_rows(
    shapes: list[MeshSource], args: argparse.Namespace, number: int
) -> list[dict[str, Any]]:
    """What verification measured of a pair's finalists."""
    mixed = mixed_pair(shapes, seed=args.seed, number=number, dense=args.dense)
    pair, limit = mixed.pair, None
    rng = np.random.default_rng([args.seed, number, 1])
    if rng.random() < LIMITED:
        pair, limit = nearly_aligned(pair, rng), rng.uniform(0.8, 1.2)
    source, target, T_true = normalized(pair, viewpoints=number % 2 == 0)
    if args.once:
        found = find_finalists(source, target, max_rotation_rad=limit)
    else:
        found, _ = find_and_judge(source, target, config=SearchConfig(), max_rotation_rad=limit)
    row = {
        "kind": mixed.kind,
        "shape": mixed.shape,
        "T": found.T_target_source.float(),
        "T_true": None if mixed.kind == "unrelated" else T_true.float(),
        "features": found.features,
        "signals": some_points(found, rng),
    }
    return [row]


def some_points(found: Finalists, rng: np.random.Generator) -> Tensor:
    """(k, 2, POINTS, s) in half precision: the signals of random points of each cloud."""
    if found.signals is None:
        raise SystemExit("expected the descriptor network's weights in the package; fit it first")
    values, sides = found.signals.values, []
    for side in range(2):
        count = int((found.signals.area[0, side] > 0).sum())
        rows = torch.from_numpy(rng.permutation(count)[:POINTS])
        chosen = values[:, side, rows]
        sides.append(torch.nn.functional.pad(chosen, (0, 0, 0, POINTS - len(rows))))
    return torch.stack(sides, 1).half()


@dataclasses.dataclass(frozen=True, eq=False)
class Collected:
    """All collected pairs, padded to the largest number of finalists."""

    features: Tensor  # (pairs, k, f)
    present: Tensor  # (pairs, k)
    right: Tensor  # (pairs, k): within the tolerance of the truth
    same: Tensor  # (pairs, k, k): within the tolerance of one another
    kind: np.ndarray
    shape: np.ndarray

    def only(self, rows: Tensor) -> Collected:
        """Some of the pairs, by a mask (pairs,)."""
        of = rows.numpy()
        return Collected(
            self.features[rows],
            self.present[rows],
            self.right[rows],
            self.same[rows],
            self.kind[of],
            self.shape[of],
        )


def load_table(rows: list[dict[str, Any]]) -> Collected:
    k = max(len(row["features"]) for row in rows)
    n = len(rows)
    features = torch.full((n, k, len(FEATURES)), math.nan, dtype=torch.float64)
    present, right = torch.zeros(n, k, dtype=torch.bool), torch.zeros(n, k, dtype=torch.bool)
    same = torch.zeros(n, k, k, dtype=torch.bool)
    for i, row in enumerate(rows):
        count = len(row["features"])
        features[i, :count] = row["features"]
        present[i, :count] = True
        same[i, :count, :count] = same_pose(row["T"], row["T"])
        if row["T_true"] is not None:
            right[i, :count] = same_pose(row["T"], row["T_true"][None])[:, 0]
    return Collected(
        features,
        present,
        right,
        same,
        np.array([row["kind"] for row in rows]),
        np.array([row["shape"] for row in rows]),
    )


def loss_of(table: Collected) -> Callable[[Tensor, Tensor], Tensor]:
    """Minus the mean log probability of what is right: a finalist, or none of them."""
    right = torch.cat([table.right, ~table.right.any(1, keepdim=True)], 1)

    def loss(log_p: Tensor, rows: Tensor) -> Tensor:
        return -torch.logsumexp(log_p.masked_fill(~right[rows], -1e9), 1).mean()

    return loss


def fit_points(args: argparse.Namespace) -> None:
    rows, signals = split_signals(read_rows(args.out), args.out / "signals.f16")
    table = load_table(rows)
    known = table.features[..., : -len(EVIDENCE)]
    network = fit_evidence(
        signals,
        verdict_inputs(known, table.present),
        table.present,
        held_out_rows(table.shape, np.random.default_rng(args.seed)),
        loss_of(table),
        width=args.width,
        steps=args.evidence_steps,
        seed=args.seed,
        checkpoint=args.out / "evidence.checkpoint",
    )
    parameters = sum(p.numel() for p in network.parameters())
    card = EVIDENCE_CARD.format(count=len(rows), parameters=parameters, data=DATA)
    write_weights(
        network.state_dict(),
        args.weights.with_name("evidence.safetensors"),
        metadata={"config": dataclasses.asdict(network.config)},
        card=card,
    )


def fit(args: argparse.Namespace) -> None:
    rows, signals = split_signals(read_rows(args.out), args.out / "signals.f16")
    table = load_table(rows)
    network = load_evidence_net()
    if network is None:
        raise SystemExit("expected the evidence network's weights; run the step `evidence` first")
    table.features[..., FEATURES.index(*EVIDENCE)][table.present] = evidence_of_all(
        network, signals
    ).double()
    rng = np.random.default_rng(args.seed)
    held_out = held_out_rows(table.shape, rng)
    forget_network(table, held_out, rng)
    inputs = verdict_inputs(table.features, table.present, fine=FINE)
    weights = fit_logit(
        inputs,
        table.present,
        held_out,
        loss_of(table),
        hidden=args.hidden,
        steps=args.steps,
        weight_decay=args.weight_decay,
        seed=args.seed,
    )
    weights = dataclasses.replace(
        weights, output=SOFTENED * weights.output, none=SOFTENED * weights.none
    )
    unseen = table.only(held_out)
    with torch.no_grad():
        log_p = log_probabilities(inputs[held_out], weights, unseen.present)
    scores = report(unseen, log_p)
    print(scores)
    card = CARD.format(count=len(table.kind), data=DATA, scores=scores)
    write_weights(vars(weights), args.weights, metadata={"features": FEATURES}, card=card)


def forget_network(table: Collected, held_out: Tensor, rng: np.random.Generator) -> None:
    """Take from some pairs of the fit what can't be measured without the descriptor network.

    The verdict has to know that case, too.
    """
    without = torch.from_numpy(rng.random(len(table.features)) < WITHOUT_NETWORK) & ~held_out
    for name in AGREEMENT + EVIDENCE:
        table.features[..., FEATURES.index(name)].masked_fill_(without[:, None], torch.nan)


def fit_trust(args: argparse.Namespace) -> None:
    rows = [{**row, "signals": None} for row in read_rows(args.out)]
    table = load_table(rows)
    held_out = held_out_rows(table.shape, np.random.default_rng(args.seed))
    with torch.no_grad():
        log_p = log_probabilities(
            verdict_inputs(table.features, table.present, fine=FINE), load_weights(), table.present
        )
    inputs = pair_inputs(table, [row["T"] for row in rows], log_p)
    best, chosen = answers(table, log_p)
    network = fit_confidence(
        inputs,
        log_p,
        held_out,
        (chosen, table.right.gather(1, best)[:, 0]),
        loss_of(table),
        steps=args.trust_steps,
        seed=args.seed,
    )
    with torch.no_grad():
        trusted = tempered(log_p, network(inputs.float()).double())
    unseen = table.only(held_out)
    scores = "\n\n".join(report(unseen, stated[held_out]) for stated in (log_p, trusted))
    print(scores)
    write_weights(
        network.state_dict(),
        args.weights.with_name("confidence.safetensors"),
        metadata={"config": dataclasses.asdict(network.config)},
        card=CONFIDENCE_CARD.format(count=len(rows), data=DATA, scores=scores),
    )


def pair_inputs(table: Collected, T: list[Tensor], log_p: Tensor) -> Tensor:
    """What the confidence of each pair depends on."""
    inputs = []
    for i, poses in enumerate(T):
        k = len(poses)
        own = torch.cat([log_p[i, :k], log_p[i, -1:]])
        same = table.same[i, :k, :k]
        inputs.append(confidence_inputs(poses.double(), table.features[i, :k], same, own))
    return torch.stack(inputs)


def answers(table: Collected, log_p: Tensor) -> tuple[Tensor, Tensor]:
    """The finalist (n, 1) that most probability lies within the tolerance of, and those (n, k)."""
    merged = torch.cat(
        [
            (table.same[some].double() @ log_p[some, :-1, None].exp())[..., 0]
            for some in torch.arange(len(log_p)).split(_AT_ONCE)
        ]
    )
    best = merged.argmax(1, keepdim=True)
    return best, table.same[torch.arange(len(best)), best[:, 0]]


def report(table: Collected, log_p: Tensor) -> str:
    """Accuracy and calibration of the answer on pairs that the fit has not seen, as a table."""
    best, chosen = answers(table, log_p)
    stated = (log_p.exp()[:, :-1] * chosen).sum(1).numpy()
    right = table.right.gather(1, best)[:, 0].numpy()
    found, kinds = table.right.any(1).numpy(), table.kind
    cells = []
    for kind in ["all", *KINDS]:
        of = np.ones(len(kinds), bool) if kind == "all" else kinds == kind
        ece = expected_calibration_error(stated[of], right[of])
        sure = stated[of] >= 0.9
        shares = (found[of].mean(), right[of].mean(), stated[of].mean(), ece, sure.mean())
        shares += (right[of][sure].mean() if sure.any() else math.nan,)
        cells.append([kind, str(of.sum()), *(f"{share:.3f}" for share in shares)])
    low = np.mean(stated[kinds == "unrelated"] <= 0.2)
    header = (
        "kind",
        "pairs",
        "truth among finalists",
        "answer right",
        "probability",
        "ECE",
        "0.9",
        "… right",
    )
    text = markdown(
        Table("verdict", "Verdict", plain_header(header), tuple(tuple(c) for c in cells))
    )
    return f"{text}\nUnrelated pairs with at most 0.2: {low:.3f}."


def main() -> None:
    steps = {"collect": collect, "evidence": fit_points, "fit": fit, "confidence": fit_trust}
    parser = steps_parser(
        __doc__, "verdict", steps=steps, collected="pairs", count=4000, shard=50, seed=20
    )
    parser.set_defaults(hidden=64, steps=6000, weight_decay=0.5)
    parser.add_argument("--width", type=int, default=32, help="of the evidence network")
    parser.add_argument("--evidence-steps", type=int, default=7000)
    parser.add_argument("--trust-steps", type=int, default=1500)
    parser.add_argument("--once", action="store_true", help="the search doesn't look twice")
    parser.add_argument("--dense", action="store_true", help="clouds of 5,000 points and more")
    args = parser.parse_args()
    steps[args.step](args)


if __name__ == "__main__":
    main()
