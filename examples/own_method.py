"""A method of one's own: ``fullturn register A B --method examples/own_method.py:PcaAxes``."""

from __future__ import annotations

import numpy as np
import torch

import fullturn
from fullturn.geometry.cloud import Cloud
from fullturn.methods.base import Estimate, Method, Traits


class PcaAxes(Method):
    """Principal axes on principal axes; of the four ways, the one that brings points nearest."""

    name = "pca-axes"
    summary = "aligns principal axes; needs nearly the same points in both clouds"
    reference = "an example"
    traits = Traits(whole=True)  # what it can't do, as the contract tests expect it

    def estimate(self, source: Cloud, target: Cloud, *, rng: np.random.Generator) -> Estimate:
        axes = [torch.linalg.svd(x.points, full_matrices=False)[2].mT for x in (source, target)]
        signs = torch.tensor([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]).to(axes[0])
        handed = torch.linalg.det(axes[0] @ axes[1].mT)  # an odd number of flips is a mirror
        poses = torch.eye(4).to(handed).repeat(4, 1, 1)
        poses[:, :3, :3] = axes[1] @ (handed * signs).diag_embed() @ axes[0].mT
        moved = source.points @ poses[:, :3, :3].mT
        apart = torch.stack([target.index.nearest(points)[1].square().mean() for points in moved])
        return Estimate(poses[apart.argmin()][None])


if __name__ == "__main__":
    cloud = np.random.default_rng(0).gamma(2.0, size=(500, 3)) * (1.0, 2.0, 3.0)
    turned = cloud @ np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]).T + 5.0
    result = fullturn.register(cloud, turned, method=f"{__file__}:PcaAxes")
    print(result.T_target_source.round(3), f"probability {result.success_probability:.3f}")
