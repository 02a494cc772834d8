from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from fullturn.data.categories import AXISYMMETRIC_CLASSES, MODELNET40_CLASSES
from fullturn.data.draw import ProtocolPairs
from fullturn.data.overlap import scan_overlap
from fullturn.data.pair import Pair
from fullturn.data.protocols import PROTOCOLS
from fullturn.data.shapes import ProceduralShapes, ShapeSource
from fullturn.data.stored import StoredPoints
from fullturn.errors import InputError
from fullturn.geometry.motion import move


class OneShapePerClass(ShapeSource):
    """Random points in the unit ball under the 40 class names."""

    def __len__(self) -> int:
        return 40

    def name(self, index: int) -> str:
        return f"{MODELNET40_CLASSES[index]}_0"

    def category(self, index: int) -> str:
        return MODELNET40_CLASSES[index]

    def points(self, index: int, count: int, rng: np.random.Generator) -> np.ndarray:
        points = rng.normal(size=(count, 3))
        return points / np.linalg.norm(points, axis=1, keepdims=True) * (0.2 + 0.02 * index)

    def points_pair(
        self, index: int, count: int, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        return self.points(index, count, rng), self.points(index, count, rng)


FIRST_POINTS = {
    "modelnet40/noisy/180": [-0.204404, 0.463064, -0.179697],
    "modelnet40/clean-resampled/180": [0.300227, -0.346572, 0.206268],
    "rpmnet/45": [0.107309, -0.816935, 0.837855],
}


def draw(name: str, count: int, seed: int = 0) -> list[Pair]:
    return list(ProtocolPairs(PROTOCOLS[name], shapes_for(name), count=count, seed=seed))


def shapes_for(name: str) -> ShapeSource:
    # A virtual camera needs meshes.
    return ProceduralShapes(3) if name.startswith("mvp-rg") else OneShapePerClass()


def angle_deg(pair: Pair) -> float:
    return float(np.degrees(Rotation.from_matrix(pair.T_target_source[:3, :3]).magnitude()))


def test_all_rows_are_there() -> None:
    expected = {
        *(f"modelnet40/{kind}/{angle}" for kind in ("clean", "noisy") for angle in (180, 45)),
        "modelnet40/clean-resampled/180",
        "modelnet40/noisy-resampled/180",
    }
    expected |= {f"{name}/unseen" for name in expected}
    expected |= {"geotransformer/180", "rpmnet/45", "predator/45", "mvp-rg", "mvp-rg-sensor"}
    assert set(PROTOCOLS) == expected


@pytest.mark.parametrize("name", PROTOCOLS)
def test_pairs_depend_on_seed_and_number_alone(name: str) -> None:
    few, other = draw(name, 2), draw(name, 1, seed=1)
    more = ProtocolPairs(PROTOCOLS[name], shapes_for(name), count=6)
    for number in (1, 0):
        a, b = few[number], more.pair(number)
        assert a.name == b.name
        for field in ("source", "target", "T_target_source"):
            assert getattr(a, field).tobytes() == getattr(b, field).tobytes()
    assert not np.array_equal(few[0].source, other[0].source)


@pytest.mark.parametrize("name", PROTOCOLS)
def test_clouds_have_the_stated_size_and_a_rigid_truth(name: str) -> None:
    pair = draw(name, 1)[0]
    size = {"modelnet40": 768, "mvp-rg": 2048, "mvp-rg-sensor": 2048}.get(name.split("/")[0], 717)
    assert pair.source.shape == pair.target.shape == (size, 3)
    assert pair.source.dtype == pair.target.dtype == np.float64
    R = pair.T_target_source[:3, :3]
    assert np.allclose(R @ R.T, np.eye(3))
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert np.array_equal(pair.T_target_source[3], [0, 0, 0, 1])


def test_clean_clouds_share_points_under_the_true_pose() -> None:
    for pair in draw("modelnet40/clean/180", 20):
        distance = cKDTree(pair.target).query(move(pair.T_target_source, pair.source))[0]
        # 768 of 1,024 kept on both sides: at least half of all points are common.
        assert np.mean(distance < 1e-9) >= 512 / 768


def test_order_does_not_give_the_matches_away() -> None:
    pair = draw("modelnet40/clean/180", 1)[0]
    index = cKDTree(pair.target).query(move(pair.T_target_source, pair.source))[1]
    assert abs(np.corrcoef(index, np.arange(len(index)))[0, 1]) < 0.15


def test_noise_is_the_only_difference_between_clean_and_noisy() -> None:
    pairs = zip(draw("modelnet40/clean/180", 20), draw("modelnet40/noisy/180", 20), strict=True)
    noise = []
    for clean, noisy in pairs:
        assert np.array_equal(clean.T_target_source, noisy.T_target_source)
        noise += [noisy.source - clean.source, noisy.target - clean.target]
    assert np.std(noise) == pytest.approx(0.01, rel=0.02)
    assert np.abs(noise).max() <= 0.05 + 1e-12


def test_resampled_clouds_share_no_point_but_the_surface() -> None:
    for pair in draw("modelnet40/clean-resampled/180", 10):
        moved = move(pair.T_target_source, pair.source)
        assert cKDTree(pair.target).query(moved)[0].min() > 0
        # The test shapes are spheres: both clouds lie on the same one.
        sphere = np.linalg.lstsq(
            np.c_[2 * pair.target, np.ones(768)], (pair.target**2).sum(axis=1), rcond=None
        )[0][:3]
        radius = np.linalg.norm(pair.target - sphere, axis=1)
        assert np.allclose(np.linalg.norm(moved - sphere, axis=1), radius.mean())


def test_far_viewpoint_crop_cuts_both_clouds_along_the_diagonal() -> None:
    diagonal = np.ones(3) / np.sqrt(3)
    for pair in draw("modelnet40/clean/180", 20):
        heights = []
        for cloud in (pair.source, pair.target):
            center = np.linalg.lstsq(
                np.c_[2 * cloud, np.ones(768)], (cloud**2).sum(axis=1), rcond=None
            )[0][:3]
            heights.append((cloud.mean(axis=0) - center) @ diagonal)
        # The same side of both posed spheres is kept.
        assert np.sign(heights[0]) == np.sign(heights[1])


@pytest.mark.parametrize(
    ("name", "limit_deg"), [("modelnet40/clean/180", 180), ("modelnet40/noisy/45", 45)]
)
def test_relative_motion_fills_its_range(name: str, limit_deg: float) -> None:
    pairs = draw(name, 400)
    angles = [angle_deg(pair) for pair in pairs]
    lengths = [np.linalg.norm(pair.T_target_source[:3, 3]) for pair in pairs]
    assert max(angles) <= limit_deg + 1e-6
    assert np.mean(angles) == pytest.approx(limit_deg / 2, rel=0.08)
    assert max(lengths) <= 0.25
    assert np.mean(lengths) == pytest.approx(0.125, rel=0.1)


LIMITED = [name for name, protocol in PROTOCOLS.items() if protocol.rotation_limit_deg is not None]


def test_the_rows_with_45_limit_the_rotation() -> None:
    assert set(LIMITED) == {name for name in PROTOCOLS if "/45" in name}
    for name, protocol in PROTOCOLS.items():
        told = ProtocolPairs(protocol, shapes_for(name), count=1).description
        assert told.get("told_rotation_deg") == protocol.rotation_limit_deg


@pytest.mark.parametrize("name", LIMITED)
def test_no_pair_is_turned_by_more_than_it_tells(name: str) -> None:
    pairs = draw(name, 300)
    (limit_deg,) = {pair.max_rotation_deg for pair in pairs}
    assert limit_deg == PROTOCOLS[name].rotation_limit_deg
    assert limit_deg is not None
    assert max(map(angle_deg, pairs)) <= limit_deg + 1e-9


@pytest.mark.parametrize("name", ["modelnet40/noisy/180", "geotransformer/180", "mvp-rg"])
def test_pairs_in_the_full_range_tell_no_limit(name: str) -> None:
    assert draw(name, 1)[0].max_rotation_deg is None


@pytest.mark.parametrize("most_deg", [1.0, 20.0, 45.0, 80.0, 89.0, 95.0, 140.0, 180.0])
def test_the_limit_of_euler_angles_is_their_largest_rotation(most_deg: float) -> None:
    angles = np.linspace(0.0, most_deg, 25)
    grid = np.stack(np.meshgrid(angles, angles, angles), axis=-1).reshape(-1, 3)
    largest = np.degrees(Rotation.from_euler("zyx", grid, degrees=True).magnitude()).max()
    limit = replace(PROTOCOLS["rpmnet/45"], max_angle_deg=most_deg).rotation_limit_deg
    if most_deg < 90.0:
        assert limit == pytest.approx(largest, abs=1e-6)
    else:
        assert limit is None
        assert largest > 170.0


@pytest.mark.parametrize("name", ["geotransformer/180", "rpmnet/45", "predator/45"])
def test_plane_protocols(name: str) -> None:
    pairs = draw(name, 200)
    shift = np.array([pair.T_target_source[:3, 3] for pair in pairs])
    assert np.abs(shift).max() <= 0.5
    assert np.abs(shift).mean() == pytest.approx(0.25, rel=0.1)
    euler = np.array(
        [Rotation.from_matrix(p.T_target_source[:3, :3]).as_euler("zyx") for p in pairs]
    )
    if name.endswith("/45"):
        assert euler.min() >= 0.0
        assert np.degrees(euler).max() <= 45.0
    # Noise of 0.01 a coordinate around a sphere; overlap grows with the share that is kept.
    keeps = {"geotransformer/180": 0.7, "rpmnet/45": 0.7, "predator/45": 0.5}[name]
    assert PROTOCOLS[name].kept_share == keeps


def test_categories_are_left_out_where_the_protocol_says_so() -> None:
    seen = Counter(pair.name.removesuffix("_0") for pair in draw("geotransformer/180", 64))
    assert set(seen) == set(MODELNET40_CLASSES) - AXISYMMETRIC_CLASSES
    assert set(seen.values()) == {2}
    unseen = {pair.name.removesuffix("_0") for pair in draw("rpmnet/45", 40)}
    assert unseen == set(MODELNET40_CLASSES[20:])
    everything = {pair.name for pair in draw("modelnet40/noisy/180", 40)}
    assert len(everything) == 40


def test_class_list_is_alphabetical() -> None:
    assert list(MODELNET40_CLASSES) == sorted(MODELNET40_CLASSES)
    assert len(MODELNET40_CLASSES) == 40


def test_unknown_categories_are_eligible_everywhere() -> None:
    assert all(protocol.allows("spaceship") for protocol in PROTOCOLS.values())


def test_no_allowed_shape_is_an_error() -> None:
    class OnlyVases(OneShapePerClass):
        def category(self, index: int) -> str:
            return "vase"

    expected = (
        "geotransformer/180 needs shapes outside the axisymmetric ones; got 40 shapes of vase"
    )
    with pytest.raises(InputError, match=expected):
        ProtocolPairs(PROTOCOLS["geotransformer/180"], OnlyVases(), count=1)

    class OnlySeen(OneShapePerClass):
        def category(self, index: int) -> str:
            return MODELNET40_CLASSES[index % 20]

    with pytest.raises(InputError, match="rpmnet/45 needs shapes outside the first 20"):
        ProtocolPairs(PROTOCOLS["rpmnet/45"], OnlySeen(), count=1)


def test_generated_shapes_serve_as_well() -> None:
    pairs = ProtocolPairs(PROTOCOLS["modelnet40/noisy-resampled/180"], ProceduralShapes(4), count=4)
    assert {pair.name for pair in pairs} == {f"procedural_0_{i:05d}" for i in range(4)}


def test_stored_points_serve_as_far_as_they_reach() -> None:
    def stored(count: int) -> StoredPoints:
        return StoredPoints(
            np.random.default_rng(0).normal(size=(2, count, 3)), ["a", "b"], ["", ""]
        )

    twice = PROTOCOLS["modelnet40/clean-resampled/180"]
    pair = ProtocolPairs(twice, stored(2048), count=1).pair(0)
    assert cKDTree(pair.target).query(move(pair.T_target_source, pair.source))[0].min() > 0
    with pytest.raises(InputError, match="needs 2,048 points of each shape; got shapes of 2,047"):
        ProtocolPairs(twice, stored(2047), count=1)
    ProtocolPairs(PROTOCOLS["rpmnet/45"], stored(2048), count=1).pair(0)
    with pytest.raises(InputError, match="rpmnet/45 needs 2,048 points"):
        ProtocolPairs(PROTOCOLS["rpmnet/45"], stored(2047), count=1)
    with pytest.raises(InputError, match="mvp-rg needs meshes"):
        ProtocolPairs(PROTOCOLS["mvp-rg"], stored(4096), count=1)


def test_virtual_scans_overlap_are_even_and_know_their_cameras() -> None:
    for pair in draw("mvp-rg", 3):
        moved = move(pair.T_target_source, pair.source)
        assert scan_overlap(moved, pair.target) >= 0.3 - 1e-3
        nearest = cKDTree(pair.target).query(pair.target, k=2)[0][:, 1]
        assert np.quantile(nearest, 0.02) > 0.4 * np.median(nearest)
        assert pair.source_viewpoint is not None
        assert pair.target_viewpoint is not None
        # 3 radii from the middle of a ball around the object.
        eye = move(pair.T_target_source, pair.source_viewpoint[None])[0]
        for viewpoint in (eye, pair.target_viewpoint):
            distance = np.linalg.norm(pair.target - viewpoint, axis=1)
            assert 2.0 - 1e-9 < distance.min() < distance.max() < 4.0
        assert np.linalg.norm(pair.T_target_source[:3, 3]) <= 0.25


def test_sensors_make_virtual_scans_rough() -> None:
    ideal, sensed = (
        [
            roughness(pair.target)
            for pair in ProtocolPairs(PROTOCOLS[name], ProceduralShapes(1), count=8)
        ]
        for name in ("mvp-rg", "mvp-rg-sensor")
    )
    assert np.mean(sensed) > 2 * np.mean(ideal)


def roughness(points: np.ndarray) -> float:
    """Median thickness of the neighborhoods of eight points, by their width."""
    near = points[cKDTree(points).query(points, k=8)[1]]
    widths = np.linalg.svd(near - near.mean(axis=1, keepdims=True), compute_uv=False)
    return float(np.median(widths[:, 2] / widths[:, 0]))


def test_a_shape_without_two_views_that_overlap_is_named() -> None:
    wanted = replace(PROTOCOLS["mvp-rg"], cloud_points=500, least_overlap=1.0)
    with pytest.raises(
        InputError, match=r"procedural_0_00000 with 500 points that overlap by 1\.0"
    ):
        ProtocolPairs(wanted, ProceduralShapes(1), count=1).pair(0)


@pytest.mark.parametrize("name", FIRST_POINTS)
def test_the_pairs_of_seed_0_stay_what_they_are(name: str) -> None:
    assert np.allclose(draw(name, 1)[0].source[0], FIRST_POINTS[name], atol=1e-6)
