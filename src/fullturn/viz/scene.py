"""What a picture of a registration needs: thinned clouds, a viewpoint, distances to partners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fullturn.errors import InputError
from fullturn.geometry.extent import strays
from fullturn.geometry.motion import invert, move
from fullturn.io.check import check_shape

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray
    from scipy.spatial import cKDTree

    from fullturn.result import Registration

SPACINGS_TO_FAR = 4.0  # a nearest point this many spacings away is drawn as "no partner"


@dataclass(frozen=True, eq=False)
class PartnerDistance:
    """Distance of every drawn point to the nearest point of the whole other cloud, in one pose."""

    source: NDArray[np.float64]  # (n,)
    target: NDArray[np.float64]  # (m,)


@dataclass(frozen=True, eq=False)
class DrawnMatches:
    """The matches that are drawn, as pairs of points, each in the frame of its cloud."""

    source: NDArray[np.float64]  # (k, 3)
    target: NDArray[np.float64]  # (k, 3)
    weight: NDArray[np.float64]  # (k,) in [0, 1]


@dataclass(frozen=True, eq=False)
class Scene:
    """The part of two clouds that is drawn; lengths are in the unit of the input."""

    source: NDArray[np.float64]  # (n, 3) drawn points, in the source frame
    target: NDArray[np.float64]  # (m, 3) drawn points, in the target frame
    source_total: int  # points before thinning
    target_total: int
    far: float  # distance from which a point counts as having no partner
    distances: tuple[PartnerDistance, ...]  # of the answer, then of each alternative
    matches: DrawnMatches

    @property
    def size(self) -> float:
        """Longest side of the larger cloud's bounding box."""
        return max(float(np.ptp(cloud, axis=0).max()) for cloud in (self.source, self.target))


def make_scene(
    source_points: ArrayLike,
    target_points: ArrayLike,
    registration: Registration,
    *,
    max_points: int,
    max_alternatives: int = 0,
    max_matches: int = 0,
) -> Scene:
    """Thin both clouds for drawing and measure how far each drawn point is from its partner.

    Stray points are not drawn: beside them, the others would be a dot.
    The thinning is random but always the same; distances go to the full other cloud.

    Raises:
        InputError: the points have another shape or are not finite, or a match points nowhere.
    """
    from scipy.spatial import cKDTree

    source = check_points(source_points, "source_points")
    target = check_points(target_points, "target_points")
    trees = cKDTree(source), cKDTree(target)
    drawn = thin(source[~strays(source)], max_points), thin(target[~strays(target)], max_points)
    poses = [registration.T_target_source]
    poses += [other.T_target_source for other in registration.alternatives[:max_alternatives]]
    return Scene(
        source=drawn[0],
        target=drawn[1],
        source_total=len(source),
        target_total=len(target),
        far=SPACINGS_TO_FAR * max(median_spacing(trees[0]), median_spacing(trees[1])),
        distances=tuple(partner_distance(pose, drawn, trees) for pose in poses),
        matches=pick_matches(source, target, registration, max_matches),
    )


def check_points(points: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return an array of finite points `(N, 3)`, at least one, or raise InputError."""
    array = check_shape(points, name).astype(np.float64)
    if not np.isfinite(array).all():
        raise InputError(
            f"{name}: expected finite coordinates, got NaN or infinite ones; remove those rows"
        )
    return array


def choose(total: int, count: int) -> NDArray[np.int64]:
    """Return `count` of `total` indices, or all if fewer: random, always the same, ascending."""
    if total <= count:
        return np.arange(total)
    # A scanner's order is regular, so taking every k-th point would draw stripes.
    return np.sort(np.random.default_rng(0).choice(total, count, replace=False))


def thin(points: NDArray[np.float64], max_points: int) -> NDArray[np.float64]:
    """Return at most `max_points` of the rows, in their order."""
    return points[choose(len(points), max_points)]


def pick_matches(
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    registration: Registration,
    count: int,
) -> DrawnMatches:
    """Look up the points of at most `count` matches."""
    kept = choose(len(registration.matches), count)
    pairs = np.asarray(registration.matches, dtype=np.int64).reshape(-1, 2)[kept]
    if len(pairs) and (pairs.min() < 0 or (pairs.max(axis=0) >= (len(source), len(target))).any()):
        raise InputError(
            f"matches: expected indices below {len(source)} and {len(target)}, got up to "
            f"{tuple(pairs.max(axis=0).tolist())}; pass the points that were registered"
        )
    return DrawnMatches(
        source=source[pairs[:, 0]],
        target=target[pairs[:, 1]],
        weight=np.asarray(registration.match_weights, dtype=np.float64)[kept],
    )


def median_spacing(tree: cKDTree) -> float:
    """Return the median distance from a point to its nearest other point (sampled)."""
    sample = thin(np.asarray(tree.data), 2000)
    if tree.n < 2:
        return 0.0
    return float(np.median(tree.query(sample, k=2)[0][:, 1]))


def partner_distance(
    T_target_source: NDArray[np.float64],
    drawn: tuple[NDArray[np.float64], NDArray[np.float64]],
    trees: tuple[cKDTree, cKDTree],
) -> PartnerDistance:
    """Measure in both directions; the target is moved back, so that no tree is rebuilt."""
    source, target = drawn
    return PartnerDistance(
        source=trees[1].query(move(T_target_source, source))[0],
        target=trees[0].query(move(invert(T_target_source), target))[0],
    )


def viewing_axes(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Choose a camera that shows the broad side: rows are right, up and toward the viewer.

    It looks along the direction of least spread, from a little to the right and above; up is the
    frame's y axis, or z where the camera would look along y.

    >>> flat = np.array([[0.0, 0, 0], [2, 0, 0], [0, 1, 0], [2, 1, 0]])
    >>> np.round(viewing_axes(flat)[1], 1)  # up is mostly y
    array([-0.1,  1. , -0.2])
    """
    spread = np.cov((points - points.mean(axis=0)).T) if len(points) > 1 else np.eye(3)
    back = np.linalg.eigh(spread)[1][:, 0]
    up = np.array([0.0, 1.0, 0.0] if abs(back[1]) < 0.8 else [0.0, 0.0, 1.0])
    back = back * (1.0 if back[np.argmax(np.abs(back))] > 0 else -1.0)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    aside, above = np.deg2rad(25.0), np.deg2rad(15.0)
    back = np.cos(above) * (np.cos(aside) * back + np.sin(aside) * right) + np.sin(above) * up
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back])


def angle_axis(T: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """Return a rotation's angle in degrees, in [0, 180], and its unit axis (z where there is none).

    >>> angle_axis(np.diag([-1.0, 1.0, -1.0, 1.0]))
    (180.0, array([0., 1., 0.]))
    """
    from scipy.spatial.transform import Rotation

    vector = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    angle = float(np.linalg.norm(vector))
    return float(np.rad2deg(angle)), vector / angle if angle > 0 else np.array([0.0, 0.0, 1.0])
