"""From a part of a scene to a short list of distinct, refined poses of the model."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from fullturn.geometry import rigid
from fullturn.geometry.sampling import evenly, point_spacing
from fullturn.locating.describe import describe
from fullturn.locating.model import DescribedViews, PreparedModel
from fullturn.locating.part import Part
from fullturn.locating.visible import best_views, nearest_views, view_directions
from fullturn.matching.correspondence import Matches, candidate_matches
from fullturn.pose import hypotheses
from fullturn.pose.grid import NearestGrid
from fullturn.pose.refine import refine_poses
from fullturn.pose.search import FIRST_SCALES


@dataclass(frozen=True)
class LocateConfig:
    """How wide the search is. Lengths are in point spacings of the level they are used at."""

    parts: int = 32  # of a scene, in which the model is looked for
    sure: float = 0.95  # probability of the surface from which no other part is looked at
    views: int = 8  # of the model, those most alike
    matches_per_view: int = 150
    match_limit: int = 1000
    length_tolerance: float = 2.5  # between two matches of one rigid motion
    companions: int = 12  # of a match, which share its motion
    scored_points: int = 150  # of each side
    refined_points: int = 250
    polished_points: int = 800
    modes: int = 64  # distinct poses that are refined
    mode_radius: float = 2.0  # RMS displacement that makes two poses distinct
    finalists: int = 24  # distinct poses that are refined on `polished_points` and measured
    finalist_share: float = 0.6  # of the best one's score, below which a pose is dropped


def find_poses(
    part: Part, model: PreparedModel, model_grid: NearestGrid, config: LocateConfig
) -> Float[Tensor, "k 4 4"]:
    """Distinct refined poses (model → part), the best first; float32."""
    level = _level_for(part, model)
    described = describe(
        part.points, voxel=level.voxel, fine_voxel=model.fine_voxel, spacing=level.spacing
    )
    matches = view_matches(described.descriptors, level, config)
    matched = hypotheses.MatchedPoints.of(
        matches, level.points, described.points, level.normals, described.normals
    )
    agreement = hypotheses.compatibility(
        matched, length_tolerance=config.length_tolerance * level.spacing
    )
    T = hypotheses.seeded_poses(matched, agreement, companions=config.companions)
    h = level.spacing
    few = _Sampled(part, model, model_grid, config.scored_points)
    kept = hypotheses.distinct(
        hypotheses.pose_distances(T, model.surface),
        few.score(T, truncation=2 * h),
        radius=config.mode_radius * h,
        limit=config.modes,
    )
    some = _Sampled(part, model, model_grid, config.refined_points)
    T = some.refine(T[kept], scales=tuple(scale * h for scale in FIRST_SCALES))
    scores = some.score(T, truncation=1.5 * h)
    kept = hypotheses.distinct(
        hypotheses.pose_distances(T, model.surface), scores, radius=h, limit=config.finalists
    )
    kept = kept[scores[kept] >= config.finalist_share * scores.amax()]
    f = part.spacing
    many = _Sampled(part, model, model_grid, config.polished_points)
    T = many.refine(T[kept], scales=(3 * f, 3 * f, 2.5 * f, 2 * f, 2 * f, 1.5 * f))
    scores = many.score(T, truncation=1.5 * f)
    kept = hypotheses.distinct(
        hypotheses.pose_distances(T, model.surface),
        scores,
        radius=0.3 * f,
        limit=config.finalists,
    )
    return T[kept]


def view_matches(
    descriptors: Float[Tensor, "n c"], level: DescribedViews, config: LocateConfig
) -> Matches:
    """Candidate matches (bag, part) out of the views that are most alike, the best first."""
    similarity = descriptors @ level.descriptors.T
    views = similarity.split(level.counts.tolist(), dim=1)
    alike = torch.stack([view.amax(1).mean() for view in views])
    first = level.counts.cumsum(0) - level.counts
    bag, part, value = [], [], []
    for number in alike.topk(min(config.views, len(views))).indices.tolist():
        found = candidate_matches(views[number].T, limit=config.matches_per_view)
        bag.append(found.source + first[number])
        part.append(found.target)
        value.append(found.similarity)
    similar, order = torch.sort(torch.cat(value), descending=True, stable=True)
    order = order[: config.match_limit]
    return Matches(torch.cat(bag)[order], torch.cat(part)[order], similar[: config.match_limit])


def _level_for(part: Part, model: PreparedModel) -> DescribedViews:
    """The finest level that is not finer than the scan."""
    spacing = point_spacing(part.points)
    for level in model.levels:
        if spacing < 1.2 * level.spacing:
            return level
    return model.levels[-1]


class _Sampled:
    """About so many points of the part and of the model, evenly over the rows."""

    def __init__(
        self, part: Part, model: PreparedModel, model_grid: NearestGrid, count: int
    ) -> None:
        self._part, self._model, self._grid = part, model, model_grid
        rows = evenly(len(part.points), count)
        self._points = part.points[rows]
        self._part_area = part.area[rows]
        # A view sees about a third of the outside.
        rows = evenly(len(model.surface), 3 * count)
        self._surface, self._area = model.surface[rows], model.area[rows]
        self._seen = model.seen[:, rows].contiguous()

    def views(self, T: Tensor, explained: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Which of the surface each pose shows, and the direction to the eye (model frame)."""
        if self._part.viewpoint is not None:
            direction = view_directions(T, self._part.viewpoint)
            return self._seen[nearest_views(direction, self._model.directions)], direction
        if explained is None:
            explained = self._explained(T, truncation=3 * self._part.spacing)
        view = best_views(explained, self._area, self._seen)
        return self._seen[view], self._model.directions[view]

    def _explained(self, T: Tensor, *, truncation: float) -> Tensor:
        parts = hypotheses.explained_parts(self._surface, self._part.grid, T, truncation=truncation)
        return torch.cat(list(parts))

    def score(self, T: Tensor, *, truncation: float) -> Tensor:
        """How well the part lies on the model, and what is visible of the model on the scene."""
        there = hypotheses.score_poses(
            self._points, self._part_area, self._grid, rigid.invert(T), truncation=truncation
        )
        explained = self._explained(T, truncation=truncation)
        seen, _ = self.views(T, explained)
        visible = seen * self._area
        return there + (explained * visible).sum(1) / visible.sum(1).clamp_min(1e-6)

    def refine(self, T: Tensor, *, scales: tuple[float, ...]) -> Tensor:
        seen, eye = self.views(T)
        return refine_poses(
            T,
            self._surface,
            self._points,
            self._grid,
            self._part.grid,
            seen=seen,
            eye=eye,
            scales=scales,
        )
