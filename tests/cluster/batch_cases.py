"""Small pairs on disk, and a method that says what it was asked and kills its process for one."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fullturn.io.save import save_cloud

SMALLEST, DEADLY = 70, 60  # numbers of points, by which the method knows a pair
METHOD = f"""
import dataclasses, os, signal, time
from pathlib import Path
import torch
from fullturn.methods.classical.icp import IcpPoint

class Marked(IcpPoint):
    name, summary, reference = "marked", "ICP that keeps a list", "these tests"
    def estimate(self, source, target, *, rng):
        with open(Path(__file__).with_name("calls.txt"), "a") as stream:
            stream.write(f"{{len(source.points)}}\\n")
        if len(source.points) == {DEADLY}:
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(0.1)
        found = super().estimate(source, target, rng=rng)
        # Stated, so that the verdict needn't be asked, which takes longer than all else.
        return dataclasses.replace(found, success_probability=torch.tensor([0.75]))
"""


def write_pairs(folder: Path, count: int, *, deadly: Sequence[int] = ()) -> Path:
    """A table of `count` pairs that ICP solves, with their clouds; some may be deadly."""
    rng = np.random.default_rng(0)
    rows = []
    for number in range(count):
        size = DEADLY if number in deadly else SMALLEST + number
        cloud = rng.normal(size=(size, 3)) * (1.0, 0.7, 0.4)
        names = {"source": f"source{number}.npy", "target": f"target{number}.npy"}
        save_cloud(folder / names["source"], cloud)
        save_cloud(folder / names["target"], cloud + number)
        rows.append({"id": f"pair {number}", **names})
    path = folder / "pairs.csv"
    with open(path, "w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, ["id", "source", "target"])
        writer.writeheader()
        writer.writerows(rows)
    return path


def write_method(folder: Path) -> str:
    """The method's name."""
    (folder / "marked.py").write_text(METHOD, encoding="utf-8")
    return f"{folder / 'marked.py'}:Marked"


def asked(folder: Path) -> list[int]:
    """The numbers of points of the sources that the method was asked about, so far."""
    calls = folder / "calls.txt"
    return [int(line) for line in calls.read_text().split()] if calls.exists() else []
