"""Put the long runs of trained_rows.py into the package: weights, cards and credits.

    python benchmarks/ship_weights.py --data DIR [--runs runs/rows]

DIR holds meshes_open_credits.csv, by which those who made the shapes are named.
"""

from __future__ import annotations

import argparse
import csv
from collections import defaultdict
from pathlib import Path

from fullturn.io.atomic import write_atomic
from fullturn.methods.learned.weights import RUN_FILE
from fullturn.training.run import CARD
from trained_rows import long_run

ROOT = Path(__file__).resolve().parents[1]
WEIGHTS = ROOT / "src" / "fullturn" / "weights"
SHIPPED = {
    "clean": long_run("clean", "180"),
    "noisy": long_run("noisy", "180"),
    "noisy-45": long_run("noisy", "45"),
}
_CREDITS = """# Credits

The weights in this folder were trained or fit on shapes that our
own generator makes and on meshes of three collections. The meshes are not in this package.

- Gazebo models (osrf/gazebo_models): copyright 2012 Nathan Koenig, CC-BY-3.0.
- Bullet's random objects (bulletphysics/bullet3, pybullet_data/random_urdfs): zlib license.
- Sweet Home 3D furniture libraries: by those named below, under the licenses beside their names.

| by | license | models |
| --- | --- | --- |
"""


def credits(path: Path) -> str:
    """Who made which models of the furniture libraries, by creator and license."""
    models: defaultdict[tuple[str, str], set[str]] = defaultdict(set)
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            models[row["creator"], row["licence"]].add(row["title"])
    lines = (
        f"| {creator} | {license} | {', '.join(sorted(titles))} |\n"
        for (creator, license), titles in sorted(models.items())
    )
    return _CREDITS + "".join(lines)


def main() -> None:
    """Copy the weights, write the cards and the credits."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="the folder of the data packs")
    parser.add_argument("--runs", type=Path, default=ROOT / "runs" / "rows")
    told = parser.parse_args()
    for name, run in SHIPPED.items():
        folder = told.runs / run.name
        write_atomic(WEIGHTS / f"gmcnet-{name}.safetensors", (folder / RUN_FILE).read_bytes())
        card = (folder / CARD).read_text(encoding="utf-8")
        card = card.replace(f"`{RUN_FILE}`", f"`gmcnet-{name}.safetensors`")
        write_atomic(WEIGHTS / f"gmcnet-{name}.md", card)
    write_atomic(WEIGHTS / "CREDITS.md", credits(told.data / "meshes_open_credits.csv"))


if __name__ == "__main__":
    main()
