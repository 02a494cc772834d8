"""The encoder written from its formulas, one point, one neighbor and one number at a time."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import nn

from fullturn.nn.clouds import CloudBatch
from fullturn.nn.config import GMCNetConfig
from fullturn.nn.encoder import Encoder

# Small, with a different k on each level and channels that split into groups.
SMALL = GMCNetConfig(neighbors=(5, 4, 3), channels=(16, 32, 32, 16))


def cloud(n: int, *, seed: int) -> torch.Tensor:
    """A bent sheet with its center away from the origin, float64."""
    rng = np.random.default_rng(seed)
    u, v = rng.uniform(-0.4, 0.4, (2, n))
    points = np.stack([u, v, u * u - 0.5 * v + 0.3 * np.sin(4 * u * v)], axis=-1)
    return torch.from_numpy(points + np.array([0.2, 0.5, 1.0]))


def dense(n: int, *, seed: int) -> torch.Tensor:
    """Small enough that each point has many neighbors within 0.1, and a normal worth its name."""
    return 0.15 * cloud(n, seed=seed)


def unit_normals(n: int, *, seed: int) -> torch.Tensor:
    vectors = torch.from_numpy(np.random.default_rng(seed).standard_normal((n, 3)))
    return vectors / vectors.norm(dim=-1, keepdim=True)


def encoder(config: GMCNetConfig, *, seed: int = 0) -> Encoder:
    """In evaluation mode, float64, with statistics that are not those of a new network."""
    generator = torch.Generator().manual_seed(seed)
    net = Encoder(config).double().eval()
    with torch.no_grad():
        for value in net.parameters():
            spread = 1 / math.sqrt(value.shape[-1]) if value.ndim == 2 else 0.5
            value.copy_(spread * torch.randn(value.shape, generator=generator, dtype=value.dtype))
        for module in net.modules():
            if isinstance(module, nn.BatchNorm1d):
                # Above 0 on average: few dead ends.
                module.bias.copy_(torch.rand(module.bias.shape, generator=generator))
                for buffer in (module.running_mean, module.running_var):
                    buffer.copy_(torch.rand(buffer.shape, generator=generator) + 0.5)
    return net


def one(points: torch.Tensor, normals: torch.Tensor | None = None) -> CloudBatch:
    return CloudBatch(
        points[None],
        torch.ones(1, len(points), dtype=torch.bool),
        None if normals is None else normals[None],
    )


def encode(net: Encoder, points: np.ndarray, normals: np.ndarray) -> list[np.ndarray]:
    """G4 of one cloud, with the weights of `net`."""
    config = net.config
    k1, k2, k3 = config.neighbors
    points = points - points.mean(0)
    n = len(points)
    graph1 = [nearest(points, i, k1) for i in range(n)]
    relation1 = [relation(config, points, normals, i, js) for i, js in enumerate(graph1)]
    split = 0 if config.rif_only else 6
    unary, nodes = [], []
    for rho in relation1:
        ri_input = np.concatenate([row[split:] for row in rho])
        ri = layer(net.ri, ri_input)
        unary.append(layer(net.unary, ri))
        other = ri_input if config.rif_only else np.concatenate([row[:6] for row in rho])
        node = np.concatenate([ri, layer(net.beside, other)])
        nodes.append(layer(net.nodes[1], layer(net.nodes[0], node)))
    smooth1 = [tpt(net.level1, nodes, i, js, relation1[i]) for i, js in enumerate(graph1)]

    features = [np.concatenate(both) for both in zip(unary, smooth1, strict=True)]
    chosen2 = farthest(points, n // config.sampling[0])
    smooth2 = []
    for i in chosen2:
        js = nearest(points, i, k2)
        rho = relation(config, points, normals, i, js)
        inner = tpt(net.level2, features, i, js, rho)
        smooth2.append(layer(net.after2[1], layer(net.after2[0], inner)))

    coarse, coarse_normals = points[chosen2], normals[chosen2]
    chosen3 = farthest(coarse, n // config.sampling[1])
    smooth3 = []
    for i in chosen3:
        js = nearest(coarse, i, k3)
        rho = relation(config, coarse, coarse_normals, i, js)
        inner = tpt(net.level3, smooth2, i, js, rho)
        smooth3.append(layer(net.after3[1], layer(net.after3[0], inner)))
    back2 = [interpolate(coarse, smooth2, p) for p in points]
    back3 = [interpolate(coarse[chosen3], smooth3, p) for p in points]
    return [np.array(term) for term in (unary, smooth1, back2, back3)]


def tpt(block: nn.Module, features: list, i: int, js: list[int], rho: np.ndarray) -> np.ndarray:
    """G1 to G3 of one center."""
    mid = block.mid
    x = [np.maximum(affine(block.input, row), 0) for row in features]
    weights1, weights2 = block.attend[0], block.attend[2]
    delta, values = [], []
    for j, rho_ij in zip(js, rho, strict=True):
        both = affine(block.key_value, x[j])
        eta = affine(block.embed[2], np.maximum(affine(block.embed[0], rho_ij), 0))
        delta.append(affine(block.query, x[i]) - both[:mid] + eta)  # G1
        values.append(both[mid:] + eta)
    gamma = affine(weights2, np.maximum(affine(weights1, np.concatenate(delta)), 0))
    groups = mid // 8
    total = np.zeros(mid)
    for channel in range(mid):
        # G2: one weight for each neighbor, shared by every groups-th channel.
        logits = [gamma[place * groups + channel % groups] for place in range(len(js))]
        alpha = [math.exp(logit) for logit in logits]
        for place in range(len(js)):  # G3
            total[channel] += values[place][channel] * alpha[place] / sum(alpha)
    return affine(block.output, np.maximum(total, 0)) + x[i]


def relation(
    config: GMCNetConfig, points: np.ndarray, normals: np.ndarray, i: int, js: list[int]
) -> np.ndarray:
    rows = []
    for j in js:
        d = points[j] - points[i]
        if config.features == "rri":
            ri = rri(points, j, js)
        else:
            ri = [angle(normals[i], d), angle(normals[j], d), angle(normals[i], normals[j])]
            ri.append(float(np.linalg.norm(d)) / 0.05)
        both = np.concatenate([points[j], d / 0.05, ri])
        rows.append(np.array(ri) if config.rif_only else both)
    return np.array(rows)


def rri(points: np.ndarray, j: int, cluster: list[int]) -> list[float]:
    """|p|, (|q| − |p|)/0.05, θ/0.05, φ of point j with the two of its cluster nearest to it."""
    p = points[j]
    axis = p / np.linalg.norm(p)
    others = sorted((m for m in cluster if m != j), key=lambda m: np.linalg.norm(points[m] - p))[:2]
    tangents = [points[m] - (points[m] @ axis) * axis for m in others]
    result: list[float] = []
    for m, own, other in zip(others, tangents, tangents[::-1], strict=True):
        q = points[m]
        turn = math.atan2(axis @ np.cross(own, other), own @ other) % (2 * math.pi)
        far = np.linalg.norm(p)
        result += [far, (np.linalg.norm(q) - far) / 0.05, angle(p, q) / 0.05, turn]
    return result


def angle(a: np.ndarray, b: np.ndarray) -> float:
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))


def nearest(points: np.ndarray, i: int, k: int) -> list[int]:
    distance = [math.dist(points[i], p) for p in points]
    return sorted(range(len(points)), key=distance.__getitem__)[:k]


def farthest(points: np.ndarray, count: int) -> list[int]:
    chosen = [0]
    while len(chosen) < count:
        reach = [min(math.dist(p, points[c]) for c in chosen) for p in points]
        chosen.append(int(np.argmax(reach)))
    return chosen


def interpolate(coarse: np.ndarray, values: list, p: np.ndarray) -> np.ndarray:
    distance = [max(math.dist(p, c), 1e-10) for c in coarse]
    three = sorted(range(len(coarse)), key=distance.__getitem__)[:3]
    total = sum(1 / distance[c] for c in three)
    return sum(values[c] / distance[c] / total for c in three)


def layer(module: nn.Module, x: np.ndarray) -> np.ndarray:
    norm = module.norm
    mean, variance, scale, shift = (
        numbers(value) for value in (norm.running_mean, norm.running_var, norm.weight, norm.bias)
    )
    normed = (affine(module.linear, x) - mean) / np.sqrt(variance + norm.eps)
    return np.maximum(normed * scale + shift, 0)


def affine(linear: nn.Linear, x: np.ndarray) -> np.ndarray:
    result = numbers(linear.weight) @ x
    return result if linear.bias is None else result + numbers(linear.bias)


def numbers(value: torch.Tensor) -> np.ndarray:
    return value.detach().numpy()
