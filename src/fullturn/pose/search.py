"""From two clouds to a short list of distinct, refined, measured poses."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from fullturn.features.surface import surface_histogram
from fullturn.geometry import rigid
from fullturn.geometry.cloud import Cloud
from fullturn.matching.correspondence import candidate_matches
from fullturn.pose import hypotheses
from fullturn.pose.grid import NearestGrid
from fullturn.pose.kabsch import nearest_rotation
from fullturn.pose.levels import LevelPair, level_pair, thin_pair
from fullturn.pose.refine import refine_poses
from fullturn.pose.verify import measure, prepare_surface


@dataclass(frozen=True)
class SearchConfig:
    """How wide the search is. Lengths are in point spacings of the level they are used at."""

    coarse_points: int = 800  # per cloud, for descriptors and hypotheses
    verify_points: int = 2048  # per cloud, for the last refinement and the verdict
    match_limit: int = 700
    length_tolerance: float = 2.5  # between two matches of one rigid motion
    score_truncation: float = 2.0
    modes: int = 96  # distinct poses refined on the coarse level
    mode_radius: float = 2.0  # RMS displacement that makes two poses distinct
    finalists: int = 32  # distinct poses measured for the verdict


@dataclass(frozen=True, eq=False)
class Finalists:
    """Distinct refined poses, and what verification measured of each."""

    T_target_source: Float[Tensor, "k 4 4"]  # float64
    features: Float[Tensor, "k f"]  # columns: `verify.FEATURES`
    spacing: float  # of the level that they were measured at
    seconds: dict[str, float]


# How alike the points of the two sides of a level are: (n, m), greater is more alike.
Similarity = Callable[[LevelPair], Tensor]


def surface_similarity(pair: LevelPair, *, radius: float = 12.0) -> Float[Tensor, "n m"]:
    """Inner products of surface histograms out to `radius` point spacings."""
    source, target = (
        surface_histogram(level.points, level.normals, level.area, radius=radius * pair.spacing)
        for level in (pair.source, pair.target)
    )
    return source @ target.T


def find_finalists(
    source: Cloud,
    target: Cloud,
    *,
    config: SearchConfig = SearchConfig(),
    similarity: Similarity = surface_similarity,
) -> Finalists:
    """Search the full range of poses; deterministic, no starting guess, no radius to tune.

    `similarity` replaces the handcrafted descriptor of the coarse level (`surface_similarity`).
    """
    clock = _Clock()
    fine = thin_pair(source.points, target.points, limit=config.verify_points)
    verify_level = level_pair(*fine)
    coarse_level = verify_level
    if max(len(points) for points in fine) > config.coarse_points:
        thinned = thin_pair(*fine, limit=config.coarse_points)
        coarse_level = level_pair(*thinned, support=fine)
    clock.lap("levels")
    T = _hypothesize(coarse_level, similarity, config, clock)
    T = _refine_on_grids(coarse_level, T, config, clock)
    if verify_level is not coarse_level:
        T = _polish(verify_level, T)
        clock.lap("refine")
    features = _measure_level(verify_level, source, target, T)
    clock.lap("verify")
    T = T.double()
    T = rigid.make(nearest_rotation(T[:, :3, :3]), T[:, :3, 3])
    return Finalists(T, features, verify_level.spacing, clock.seconds)


def measure_pose(
    source: Cloud,
    target: Cloud,
    T_target_source: Float[Tensor, "4 4"],
    *,
    config: SearchConfig = SearchConfig(),
) -> Float[Tensor, "1 f"]:
    """What verification measures of one pose, found in whatever way."""
    level = level_pair(*thin_pair(source.points, target.points, limit=config.verify_points))
    return _measure_level(level, source, target, T_target_source[None].float())


def _measure_level(pair: LevelPair, source: Cloud, target: Cloud, T: Tensor) -> Tensor:
    surfaces = [
        prepare_surface(level, spacing=pair.spacing, viewpoint=cloud.viewpoint)
        for level, cloud in ((pair.source, source), (pair.target, target))
    ]
    return measure(T, surfaces[0], surfaces[1], spacing=pair.spacing)


def _hypothesize(
    pair: LevelPair, similarity: Similarity, config: SearchConfig, clock: _Clock
) -> Tensor:
    h, source, target = pair.spacing, pair.source, pair.target
    alike = similarity(pair)
    clock.lap("describe")
    matches = candidate_matches(alike, limit=config.match_limit)
    agreement = hypotheses.compatibility(
        matches,
        source.points,
        target.points,
        source.normals,
        target.normals,
        length_tolerance=config.length_tolerance * h,
    )
    clock.lap("match")
    T = hypotheses.seeded_poses(matches, source.points, target.points, agreement)
    clock.lap("hypothesize")
    return T


def _refine_on_grids(pair: LevelPair, T: Tensor, config: SearchConfig, clock: _Clock) -> Tensor:
    h, source, target = pair.spacing, pair.source.points, pair.target.points
    grids = _grids(pair, band=3 * h)
    scores = hypotheses.score_poses(
        source[::4], pair.source.area[::4], grids[1], T, truncation=2 * h
    )
    coordinates = hypotheses.pose_coordinates(T, source)
    kept = hypotheses.distinct(
        coordinates, scores, radius=config.mode_radius * h, limit=config.modes
    )
    clock.lap("score")
    T = refine_poses(
        T[kept],
        source[::3],
        target[::3],
        *grids,
        scales=(3 * h,) * 3 + (2.5 * h,) * 3 + (2 * h,) * 3,
    )
    both = _two_sided(pair, grids, T, truncation=1.5 * h)
    kept = hypotheses.distinct(
        hypotheses.pose_coordinates(T, source), both, radius=h, limit=config.finalists
    )
    T = refine_poses(T[kept], source, target, *grids, scales=(1.5 * h,) * 3 + (1.2 * h,) * 4)
    clock.lap("refine")
    return T


def _polish(pair: LevelPair, T: Tensor) -> Tensor:
    """Refine on a finer level."""
    h = pair.spacing
    scales = (2 * h,) * 4 + (1.5 * h,) * 3
    grids = _grids(pair, band=2 * h)
    return refine_poses(T, pair.source.points, pair.target.points, *grids, scales=scales)


def _grids(pair: LevelPair, *, band: float) -> list[NearestGrid]:
    return [
        NearestGrid(level.points, level.normals, cell=0.75 * pair.spacing, band=band)
        for level in (pair.source, pair.target)
    ]


def _two_sided(
    pair: LevelPair, grids: list[NearestGrid], T: Tensor, *, truncation: float
) -> Tensor:
    source, target = pair.source, pair.target
    forward = hypotheses.score_poses(source.points, source.area, grids[1], T, truncation=truncation)
    back = hypotheses.score_poses(
        target.points, target.area, grids[0], rigid.invert(T), truncation=truncation
    )
    return forward + back


class _Clock:
    """Wall-clock seconds per stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._last
        self._last = now
