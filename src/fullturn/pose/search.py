"""From two clouds to a short list of distinct, refined, measured poses."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.geometry.cloud import Cloud
from fullturn.geometry.sampling import evenly
from fullturn.matching.correspondence import candidate_matches
from fullturn.pose import hypotheses
from fullturn.pose.contact import contacts, prepare_surface
from fullturn.pose.evidence import PointSignals, evidence, point_signals
from fullturn.pose.grid import NearestGrid
from fullturn.pose.kabsch import nearest_motion
from fullturn.pose.levels import LevelPair, level_pair, thin_pair, whole_pair
from fullturn.pose.refine import lay_on_points, refine_poses
from fullturn.pose.similarity import Similarity, histogram_similarity, network_similarity
from fullturn.pose.verify import FEATURES, MEASURED, agreement, likenesses, measure

# How far hypotheses may lie beyond the largest possible rotation, for refinement to bring them
# back, and refined poses, which have errors, too.
_LIMIT_SLACK_RAD = math.radians(15.0)
LIMIT_EDGE_RAD = math.radians(3.0)


# So many points of a cloud are enough to tell a thousand poses apart, and to draw the best of them
# to where they belong.
_SCORED_POINTS, _REFINED_POINTS = 100, 200
# Of the first refinement, in spacings of the coarse level: as wide as a hypothesis may be off, then
# narrower, so that points that are no partners let go.
FIRST_SCALES = (3.0,) * 3 + (2.5,) * 3 + (2.0,) * 3
NO_WEIGHTS = "no descriptor weights in the package: matched by handcrafted histograms"
_CLOSE = 0.1  # spacings within which points of one sampling lie on one another
_LITTLE_OVERLAP = 0.05  # keeps the merit of poses that hardly overlap finite


@dataclass(frozen=True)
class SearchConfig:
    """How wide the search is. Lengths are in point spacings of the level they are used at."""

    coarse_points: int = 800  # per cloud, for descriptors and hypotheses
    verify_points: int = 2048  # per cloud, for the last refinement and the verdict
    length_tolerance: float = 2.5  # between two matches of one rigid motion
    companions: int = 6  # of a match, which share its motion
    mode_radius: float = 2.0  # RMS displacement that makes two poses distinct
    # Distinct poses that are refined on the coarse level: those that overlap most, and those that
    # bring most matches together for their overlap. Each finds what the other one misses.
    modes: int = 32
    matched_modes: int = 32
    # … and of these, in the same two ways, those that are measured for the verdict.
    finalists: int = 20
    matched_finalists: int = 12
    # Share of the best pose's overlap below which a pose is dropped: of those chosen by it after
    # the first refinement, and of all before the verdict.
    mode_share: float = 0.5
    finalist_share: float = 0.6
    # What finds matches: the descriptor network, or handcrafted histograms.
    descriptor: Literal["network", "histogram"] = "network"

    def wider(self, *, modes: int, finalists: int) -> SearchConfig:
        """The same with so many times as many modes, and so many times as many finalists."""
        return replace(
            self,
            modes=modes * self.modes,
            matched_modes=modes * self.matched_modes,
            finalists=finalists * self.finalists,
            matched_finalists=finalists * self.matched_finalists,
        )


@dataclass(frozen=True, eq=False)
class Finalists:
    """Distinct refined poses, and what verification measured of each."""

    T_target_source: Float[Tensor, "k 4 4"]  # float64
    features: Float[Tensor, "k f"]  # columns: `verify.FEATURES`
    signals: PointSignals | None  # what one of them sums up; None without the descriptor network
    spacing: float  # of the level that they were measured at
    seconds: dict[str, float]
    notes: tuple[str, ...] = ()  # what a user should know of how they were found


def find_finalists(
    source: Cloud,
    target: Cloud,
    *,
    config: SearchConfig = SearchConfig(),
    max_rotation_rad: float | None = None,
    given: Float[Tensor, "g 4 4"] | None = None,
) -> Finalists:
    """Search the full range of poses; deterministic, no starting guess, no radius to tune.

    `max_rotation_rad` is the largest rotation that is possible, where somebody knows one. Poses
    `given` from elsewhere are measured as they are, with those found, and come first.
    """
    search = Search(source, target, config=config, max_rotation_rad=max_rotation_rad)
    return search.finalists(config, given=given)


class Search:
    """Two clouds and all hypotheses of their pose, out of which finalists are chosen.

    Arguments as of `find_finalists`; `similarity` finds the matches in place of the descriptor that
    the configuration names.
    """

    def __init__(
        self,
        source: Cloud,
        target: Cloud,
        *,
        config: SearchConfig,
        similarity: Similarity | None = None,
        max_rotation_rad: float | None = None,
    ) -> None:
        self._clouds, self._max_rotation_rad = (source, target), max_rotation_rad
        self._clock = clock = _Clock()
        self._coarse, self._fine = coarse, _ = coarse_and_fine(source, target, config)
        clock.lap("levels")
        self._learned = network_similarity(coarse) if config.descriptor == "network" else None
        self._notes: tuple[str, ...] = ()
        if self._learned is None and config.descriptor == "network":
            self._notes = (NO_WEIGHTS,)
        alike = self._learned if similarity is None else similarity(coarse)
        if alike is None:
            alike = histogram_similarity(coarse) if self._learned is None else self._learned
        clock.lap("describe")
        self._matched = _matched(coarse, alike)
        clock.lap("match")
        T = _hypothesize(
            self._matched, config, spacing=coarse.spacing, max_rotation_rad=max_rotation_rad
        )
        clock.lap("hypothesize")
        h, some = coarse.spacing, evenly(len(coarse.source.points), _SCORED_POINTS)
        self._grids = _grids(coarse, band=3 * h)
        overlap = hypotheses.score_poses(
            coarse.source.points[some],
            coarse.source.area[some],
            self._grids[1],
            T,
            truncation=2 * h,
        )
        self._hypotheses = self._scored(T, overlap)
        clock.lap("score")

    def finalists(
        self, config: SearchConfig, *, given: Float[Tensor, "g 4 4"] | None = None
    ) -> Finalists:
        """As many as `config` says, out of the hypotheses that are there."""
        T = self._refined_on_grids(config)
        T = _within(T, self._max_rotation_rad, slack_rad=LIMIT_EDGE_RAD)
        if self._fine is not self._coarse:
            T = _polish(self._fine, T)
            T = _within(T, self._max_rotation_rad, slack_rad=LIMIT_EDGE_RAD)
        else:
            T = _laid_on_points(self._fine, self._grids, T)
        self._clock.lap("refine")
        if given is not None:
            T = torch.cat([given.to(T), T])
        features, signals = _measured(T, self._fine, self._coarse, self._clouds, self._learned)
        self._clock.lap("verify")
        T = nearest_motion(T.double())
        seconds = dict(self._clock.seconds)
        return Finalists(T, features, signals, self._fine.spacing, seconds, self._notes)

    def _refined_on_grids(self, config: SearchConfig) -> Tensor:
        pair, grids = self._coarse, self._grids
        h, source, target = pair.spacing, pair.source.points, pair.target.points
        T = self._hypotheses.chosen(
            radius=config.mode_radius * h, limits=(config.modes, config.matched_modes)
        )
        T = refine_poses(
            T,
            source[evenly(len(source), _REFINED_POINTS)],
            target[evenly(len(target), _REFINED_POINTS)],
            *grids,
            scales=tuple(scale * h for scale in FIRST_SCALES),
        )
        T = self._scored(T, _two_sided(pair, grids, T, truncation=1.5 * h)).chosen(
            radius=h,
            limits=(config.finalists, config.matched_finalists),
            least_share=config.mode_share,
        )
        T = refine_poses(T, source, target, *grids, scales=(1.5 * h,) * 3 + (1.2 * h,) * 4)
        overlap = _two_sided(pair, grids, T, truncation=h)
        kept = hypotheses.distinct(
            hypotheses.pose_distances(T, source), overlap, radius=0.2 * h, limit=len(T)
        )
        return T[kept[overlap[kept] >= config.finalist_share * overlap.amax()]]

    def _scored(self, T: Tensor, overlap: Tensor) -> _Scored:
        pair = self._coarse
        share = hypotheses.matched_share(self._matched, T, truncation=2 * pair.spacing)
        merit = share / (overlap + _LITTLE_OVERLAP).sqrt()
        return _Scored(T, hypotheses.pose_distances(T, pair.source.points), overlap, merit)


@dataclass(frozen=True, eq=False)
class _Scored:
    """Poses, how much overlaps, and how many matches they bring together for that overlap.

    Where clouds overlap little, wrong poses overlap more than the right one; that matches lie on
    one another by chance grows with the overlap, too.
    """

    T: Float[Tensor, "k 4 4"]
    apart: Float[Tensor, "k k"]
    overlap: Float[Tensor, " k"]
    merit: Float[Tensor, " k"]

    def chosen(
        self, *, radius: float, limits: tuple[int, int], least_share: float = 0.0
    ) -> Float[Tensor, "m 4 4"]:
        """Distinct poses: those of most overlap, and those that match best for their overlap."""
        overlap = self.overlap
        most = hypotheses.distinct(self.apart, overlap, radius=radius, limit=limits[0])
        most = most[overlap[most] >= least_share * overlap.amax()]
        matching = hypotheses.distinct(self.apart, self.merit, radius=radius, limit=limits[1])
        return self.T[torch.cat([most, matching]).unique()]


def coarse_and_fine(
    source: Cloud, target: Cloud, config: SearchConfig = SearchConfig()
) -> tuple[LevelPair, LevelPair]:
    """The level of the search and that of the verdict; one and the same for small clouds."""
    if _most_points(source, target) > config.verify_points:
        thinned = thin_pair(source.distinct, target.distinct, limit=config.verify_points)
        source, target = Cloud(thinned[0]), Cloud(thinned[1])
    fine = whole_pair(source, target)
    if _most_points(source, target) <= config.coarse_points:
        return fine, fine
    thinned = thin_pair(source.distinct, target.distinct, limit=config.coarse_points)
    return level_pair(*thinned, support=(source, target)), fine


def _most_points(source: Cloud, target: Cloud) -> int:
    return max(len(source.distinct), len(target.distinct))


def _measured(
    T: Tensor,
    pair: LevelPair,
    coarse: LevelPair,
    clouds: tuple[Cloud, Cloud],
    learned: Tensor | None,
) -> tuple[Tensor, PointSignals | None]:
    """The features of poses, and the signals that one of them sums up."""
    surfaces = [
        prepare_surface(level, spacing=pair.spacing, viewpoint=cloud.viewpoint)
        for level, cloud in zip((pair.source, pair.target), clouds, strict=True)
    ]
    met = contacts(T, *surfaces)
    measured = measure(met, spacing=pair.spacing)
    if learned is None:
        rest = measured.new_full((len(T), len(FEATURES) - len(MEASURED)), math.nan)
        return torch.cat([measured, rest], 1), None
    sides = likenesses(T, coarse, learned)
    signals = point_signals(met, sides, pair, coarse)
    agreed = agreement(sides, spacing=coarse.spacing)
    return torch.cat([measured, agreed, evidence(signals)], 1), signals


def _matched(pair: LevelPair, alike: Tensor) -> hypotheses.MatchedPoints:
    (source, source_normals), (target, target_normals) = (
        (level.points[level.keypoints], level.normals[level.keypoints])
        for level in (pair.source, pair.target)
    )
    return hypotheses.MatchedPoints.of(
        candidate_matches(alike), source, target, source_normals, target_normals
    )


def _hypothesize(
    matched: hypotheses.MatchedPoints,
    config: SearchConfig,
    *,
    spacing: float,
    max_rotation_rad: float | None,
) -> Tensor:
    agreement = hypotheses.compatibility(
        matched,
        length_tolerance=config.length_tolerance * spacing,
        max_rotation_rad=None if max_rotation_rad is None else max_rotation_rad + LIMIT_EDGE_RAD,
    )
    T = hypotheses.seeded_poses(matched, agreement, companions=config.companions)
    return _within(T, max_rotation_rad, slack_rad=_LIMIT_SLACK_RAD)


def _within(T: Tensor, max_rotation_rad: float | None, *, slack_rad: float) -> Tensor:
    """The poses that turn no more than is possible.

    If none does, the one that turns least, turned back to the limit about the source's mean.
    """
    if max_rotation_rad is None:
        return T
    angle = rigid.rotation_angle_rad(T[:, :3, :3])
    within = angle <= max_rotation_rad + slack_rad
    if bool(within.any()):
        return T[within]
    T = T[angle.argmin()][None]
    R = rigid.exp_so3(rigid.log_so3(T[:, :3, :3]) * (max_rotation_rad / angle.min()))
    return rigid.make(R, T[:, :3, 3])


def _polish(pair: LevelPair, T: Tensor) -> Tensor:
    """Refine on a finer level."""
    h = pair.spacing
    scales = (2 * h,) * 4 + (1.5 * h,) * 3
    grids = _grids(pair, band=2 * h)
    T = refine_poses(T, pair.source.points, pair.target.points, *grids, scales=scales)
    return _laid_on_points(pair, grids, T)


def _laid_on_points(pair: LevelPair, grids: list[NearestGrid], T: Tensor) -> Tensor:
    return lay_on_points(T, pair.source.points, grids[1], close=_CLOSE * pair.spacing)


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
    return (forward + back) / 2


class _Clock:
    """Wall-clock seconds per stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._last
        self._last = now
