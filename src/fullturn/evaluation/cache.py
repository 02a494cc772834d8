"""Predictions on disk, one line each, written as they come: a killed run goes on where it was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fullturn.evaluation.predict import Prediction
from fullturn.io.lines import CheckedLines


class PredictionCache:
    """The predictions of one method, as its code is, for one seed, by the hash of the pair.

    A line that was cut off or damaged is dropped (`damaged` counts them), so its pair is predicted
    again.
    """

    def __init__(self, path: str | Path) -> None:
        self.found: dict[str, Prediction] = {}
        self._lines = CheckedLines(path, self._take, otherwise="choose another with --cache")

    @property
    def path(self) -> Path:
        return self._lines.path

    @property
    def damaged(self) -> int:
        return self._lines.damaged

    def add(self, pair: str, prediction: Prediction) -> None:
        """Keep a prediction, here and on disk."""
        self.found[pair] = prediction
        self._lines.add(
            {
                "pair": pair,
                "T_target_source": prediction.T_target_source.tolist(),
                "success_probability": prediction.success_probability,
                "alternatives": [T.tolist() for T in prediction.alternatives],
                "error": prediction.error,
                "cpu_seconds": prediction.cpu_seconds,
                "wall_seconds": prediction.wall_seconds,
            }
        )

    def _take(self, content: dict[str, Any]) -> None:
        pair = content.pop("pair")
        content["T_target_source"] = np.array(content["T_target_source"])
        content["alternatives"] = tuple(np.array(T) for T in content["alternatives"])
        self.found[pair] = Prediction(**content)
