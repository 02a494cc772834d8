"""GMCNet as a method: its one-shot pose, and its descriptors for the default search."""

from __future__ import annotations

import hashlib
import re
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.errors import InputError
from fullturn.geometry.cloud import Cloud
from fullturn.methods.base import Estimate, Method
from fullturn.methods.consensus import Consensus
from fullturn.methods.learned.weights import RUN_FILE, find_weights, load_gmcnet
from fullturn.nn.clouds import CloudBatch
from fullturn.pose.kabsch import nearest_motion
from fullturn.pose.levels import LevelPair, thin_pair

DEFAULT_WEIGHTS = "noisy"
_MOST_POINTS = 2048  # of a cloud that the network sees; the paper's have 768 to 2,048
_REFERENCE = "Pan, Cai & Liu, Robust Partial-to-Partial Point Cloud Registration in a Full Range"


class _Learned(Method):
    """Weights, and what they say of a run. Clouds arrive centered on their means, so a rule that
    orients normals to the origin orients them to the mean."""

    weights: ClassVar[Path]
    reference = _REFERENCE

    def __init__(self) -> None:
        self.network = load_gmcnet(self.weights)

    @classmethod
    def settings(cls) -> dict[str, Any]:
        sha256 = hashlib.sha256(cls.weights.read_bytes()).hexdigest()
        return {**super().settings(), "weights": cls.weights.name, "sha256": sha256}


class Gmcnet(_Learned):
    """The paper's answer: soft correspondences and one weighted Kabsch, nothing after it."""

    summary = "GMCNet, one shot: the pose of soft correspondences between learned descriptors"

    def estimate(self, source: Cloud, target: Cloud, *, rng: np.random.Generator) -> Estimate:
        clouds = source.points, target.points
        if max(map(len, clouds)) > _MOST_POINTS:
            clouds = thin_pair(*clouds, limit=_MOST_POINTS)
        with torch.no_grad():
            found = self.network(*(CloudBatch.collate([points.float()]) for points in clouds))
        T = found.T_target_source.double()
        if not bool(T.isfinite().all()):
            T = torch.eye(4).to(T)[None]
        return Estimate(nearest_motion(T))


class GmcnetConsensus(_Learned, Consensus):
    """The default method with the network's scores in place of its own descriptors."""

    summary = "GMCNet's descriptors as matches for the search of the default method"

    def similarity(self, pair: LevelPair) -> Float[Tensor, "k l"]:
        source, target = (
            CloudBatch.collate([level.points.float()]) for level in (pair.source, pair.target)
        )
        with torch.no_grad():
            terms = [self.network.encode(cloud) for cloud in (source, target)]
            score = self.network.score(source, target, *terms)[0]
        return score[pair.source.keypoints][:, pair.target.keypoints]


@cache
def learned_method(name: str) -> type[Method]:
    """The class of "gmcnet", "gmcnet@WEIGHTS", "gmcnet+consensus" or "gmcnet@WEIGHTS+consensus".

    WEIGHTS is a name inside the package or the path of a file; a file that a run wrote goes by the
    name of its folder.

    Raises:
        InputError: another form, or no such weights.
    """
    parts = re.fullmatch(r"gmcnet(?:@(.+?))?(\+consensus)?", name)
    if parts is None:
        raise InputError(
            f"method: expected gmcnet[@WEIGHTS][+consensus], got {name!r:.200}; WEIGHTS is a name "
            "or the path of a .safetensors file"
        )
    path = find_weights(parts[1] or DEFAULT_WEIGHTS)
    base = GmcnetConsensus if parts[2] else Gmcnet
    label = name
    if path.name == RUN_FILE:
        label = f"gmcnet@{path.resolve().parent.name}{parts[2] or ''}"
    known = {"name": label, "weights": path, "files": (path,), "__module__": base.__module__}
    return type(base.__name__, (base,), known)
