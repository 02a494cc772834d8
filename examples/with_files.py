"""From two files to a pose file, an aligned cloud and a report: with_files.py [SOURCE TARGET]."""

from __future__ import annotations

import sys

import numpy as np

import fullturn
from fullturn.data.procedural import dog
from fullturn.data.scan import scan_pair
from fullturn.io import save_cloud, write_transform
from fullturn.viz.report import write_report


def main(paths: list[str]) -> None:
    if not paths:
        pair = scan_pair(dog(), np.random.default_rng(0), points=1024, min_overlap=0.4)
        paths = ["source.ply", "target.ply"]
        save_cloud(paths[0], pair.source)
        save_cloud(paths[1], pair.target)

    # Loaded once, so that the matches count the very points that the report draws.
    source, target = (fullturn.load_cloud(path) for path in paths)
    result = fullturn.register(source, target)

    T = result.T_target_source
    write_transform("pose.txt", T)
    save_cloud("aligned.ply", source.points @ T[:3, :3].T + T[:3, 3])
    names = {"source_name": source.name, "target_name": target.name}
    write_report("report.html", source.points, target.points, result, **names)
    print(f"probability {result.success_probability:.3f}; open report.html in a browser")


if __name__ == "__main__":
    main(sys.argv[1:])
