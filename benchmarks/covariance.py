"""Measure whether the covariance of a registration is as large as its errors.

    python benchmarks/covariance.py --data DIR [--count 100] [--meshes SHAPES] [--out results]

DIR holds modelnet40_subset.npz; sets that need meshes take them from SHAPES. Of the pairs that
consensus gets right, the squared error in units of the covariance, ξᵀ C⁻¹ ξ with
T_true = T_found Exp(ξ), should be distributed as χ² with six degrees of freedom.
Writes covariance.json and covariance.md.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from scipy.stats import chi2

import fullturn
from fullturn.data.open import open_shapes, protocol_pairs
from fullturn.data.pair_set import PairSet
from fullturn.evaluation.layout import Table, markdown, number
from fullturn.evaluation.metrics import pose_success
from fullturn.geometry import rigid
from fullturn.progress import progress_bar

POINTS = ("modelnet40/noisy/180", "modelnet40/noisy-resampled/180", "geotransformer/180")
MESHES = ("mixture", "mvp-rg")
SHAPES = "modelnet40_subset.npz:dev_eval"
LEVELS = (0.5, 0.9, 0.95)
FREEDOM = 6
FAR = 10.0
EXPLANATION = """\
Of the pairs that are right (within 5° and 5 % of the radius), ξᵀ C⁻¹ ξ, the squared error in units
of the covariance, against χ² with six degrees of freedom.

- Median: of the squared errors, over that of χ². 1 is calibrated, more says that errors are larger
  than stated.
- Inside: the share of pairs whose truth lies in the 50 %, 90 % and 95 % ellipsoid.
- Factor: what the covariance would have to be multiplied by for the 90 % ellipsoid to hold 90 %.
- Beyond: the share of pairs whose error is more than ten times (squared) what the 95 % ellipsoid
  allows. No factor mends these: the pose lies in another optimum close to the true one, or points
  were matched wrongly, and the covariance describes the noise around the pose that was found.
- Loose: the share whose error is less than a hundredth (squared) of the median of χ². Exact copies
  of points are among them, which are stated to be known to 1e-6 and are known better, and scans
  that are flat and free of noise, of which a slide is stated to be open and was found well.
"""


def normalized_square(
    T_found: Float[np.ndarray, "4 4"],
    T_true: Float[np.ndarray, "4 4"],
    covariance: Float[np.ndarray, "6 6"],
) -> float:
    """ξᵀ C⁻¹ ξ with T_true = T_found Exp(ξ), ξ the rotation vector (rad), then the translation.

    >>> T_true = np.eye(4)
    >>> T_true[0, 3] = 0.2
    >>> round(normalized_square(np.eye(4), T_true, 0.01 * np.eye(6)), 6)
    4.0
    """
    error = rigid.log_se3(torch.from_numpy(np.linalg.solve(T_found, T_true))).numpy()
    return float(error @ np.linalg.solve(covariance, error))


def summarize(squares: Sequence[float]) -> dict[str, Any]:
    """How the normalized squared errors of right pairs compare with χ²."""
    values = np.asarray(squares, dtype=np.float64)
    inside = {f"{level:g}": float(np.mean(values <= chi2.ppf(level, FREEDOM))) for level in LEVELS}
    return {
        "right": len(values),
        "median_ratio": float(np.median(values) / chi2.median(FREEDOM)),
        "inside": inside,
        "factor": float(np.quantile(values, 0.9) / chi2.ppf(0.9, FREEDOM)),
        "beyond": float(np.mean(values > FAR * chi2.ppf(0.95, FREEDOM))),
        "loose": float(np.mean(values < chi2.median(FREEDOM) / FAR**2)),
    }


def measure(pairs: PairSet, *, seed: int = 0) -> dict[str, Any]:
    """Register all pairs and sum up those that are right."""
    squares: list[float] = []
    with progress_bar(pairs.name, len(pairs)) as advance:
        for pair in pairs:
            found = fullturn.register(
                pair.source,
                pair.target,
                method="consensus",
                seed=seed,
                source_viewpoint=pair.source_viewpoint,
                target_viewpoint=pair.target_viewpoint,
            )
            T_found, T_true = found.T_target_source, pair.T_target_source
            if pair.related and pose_success(T_found, T_true, pair.source):
                squares.append(normalized_square(T_found, T_true, found.covariance))
            advance(1)
    told = [float(f"{square:.6g}") for square in squares]
    return {"n": len(pairs), **(summarize(squares) if squares else {"right": 0}), "squares": told}


def table(sets: dict[str, dict[str, Any]]) -> Table:
    """One row a set."""
    header = ("pairs", "n", "right", "median", *(f"inside {100 * x:g} %" for x in LEVELS))
    header += ("factor", "beyond", "loose")
    rows = []
    for name, one in sets.items():
        cells = [name, str(one["n"]), str(one["right"])]
        if one["right"]:
            cells.append(number(one["median_ratio"], 2))
            cells += [f"{number(share, '%')} %" for share in one["inside"].values()]
            cells.append(number(one["factor"], 2))
            cells += [f"{number(one[key], '%')} %" for key in ("beyond", "loose")]
        rows.append((*cells, *["–"] * (len(header) - len(cells))))
    return Table("covariance", "Covariance", tuple((head,) for head in header), tuple(rows))


def page(sets: dict[str, dict[str, Any]]) -> str:
    """The Markdown that is written."""
    return f"# Is the covariance as large as the errors?\n\n{EXPLANATION}\n{markdown(table(sets))}"


def main() -> None:
    """Measure all sets and write both files."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--meshes", default="procedural:100000:1000", help="as --shapes takes them")
    parser.add_argument("--sets", nargs="+", default=[*POINTS, *MESHES])
    parser.add_argument("--count", type=int, default=100, help="pairs of each set")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("results"))
    told = parser.parse_args()
    points, meshes = open_shapes(str(told.data / SHAPES)), open_shapes(told.meshes)
    sets = {}
    for name in told.sets:
        shapes = points if name in POINTS else meshes
        ((pairs,), _) = protocol_pairs([name], shapes, count=told.count, seed=told.seed)
        sets[name] = measure(pairs, seed=told.seed)
    told.out.mkdir(parents=True, exist_ok=True)
    content = {"seed": told.seed, "meshes": told.meshes, "sets": sets}
    (told.out / "covariance.json").write_text(json.dumps(content, indent=1) + "\n", "utf-8")
    (told.out / "covariance.md").write_text(page(sets), "utf-8")
    print(page(sets))


if __name__ == "__main__":
    main()
