"""Draw the picture of the README: two real range scans, before and after registration.

    python benchmarks/readme_picture.py --data DIR

Both scans are turned and shifted at random and registered; the picture shows the result upright.
The error is measured against Stanford's own alignment. Credit for the scans: Stanford Computer
Graphics Laboratory.
"""

from __future__ import annotations

import argparse
import dataclasses
import io
import json
import os
from pathlib import Path

import numpy as np
from PIL import Image

import fullturn
from fullturn.data.motion import ball_translation, uniform_rotation
from fullturn.evaluation.metrics import rotation_error_deg
from fullturn.geometry.motion import invert, move, rigid
from fullturn.viz.figures import draw_figure
from fullturn.viz.tables import probability

DPI = 110
COLORS = 128  # of the palette: a third of the bytes, and no difference to be seen


def draw(folder: Path, names: tuple[str, str], *, seed: int) -> bytes:
    """Register two scans of one object from random poses; the picture as PNG."""
    rng = np.random.default_rng(seed)
    poses = json.loads((folder / "poses.json").read_text())
    clouds, T_world_cloud = [], []
    for name in names:
        scan = fullturn.load_cloud(folder / name).points
        size = float(np.ptp(scan, axis=0).max())
        T_cloud_scan = rigid(uniform_rotation(rng), ball_translation(rng, max_length=size))
        clouds.append(move(T_cloud_scan, scan))
        T_world_cloud.append(np.array(poses[name]) @ invert(T_cloud_scan))
    source, target = clouds
    result = fullturn.register(source, target)
    true = invert(T_world_cloud[1]) @ T_world_cloud[0]
    error_deg = float(rotation_error_deg(result.T_target_source, true))
    title = (
        f"Two range scans of the Stanford {folder.name}, each turned at random: "
        f"rotation found to {error_deg:.2f}°, probability {probability(result.success_probability)}"
    )
    upright = dataclasses.replace(result, T_target_source=T_world_cloud[1] @ result.T_target_source)
    figure = draw_figure(source, move(T_world_cloud[1], target), upright, title=title)
    drawn, packed = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, format="png", dpi=DPI)
    picture = Image.open(drawn).convert("RGB").quantize(COLORS, dither=Image.Dither.NONE)
    picture.save(packed, format="png", optimize=True)
    print(title)
    return packed.getvalue()


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--object", default="bunny")
    parser.add_argument("--scans", nargs=2, default=("bun000.ply", "bun090.ply"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("docs/images/real_scans.png"))
    parser.add_argument(
        "--data",
        type=Path,
        default=os.environ.get("FULLTURN_DATA"),
        help="folder with the data packs; default: the environment variable FULLTURN_DATA",
    )
    arguments = parser.parse_args()
    if arguments.data is None:
        parser.error("pass --data DIR or set FULLTURN_DATA to the folder with the data packs")
    folder = Path(arguments.data) / "stanford_scans" / arguments.object
    picture = draw(folder, tuple(arguments.scans), seed=arguments.seed)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_bytes(picture)


if __name__ == "__main__":
    main()
