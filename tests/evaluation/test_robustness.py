"""The feature study against what can be derived, and against what its features promise."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from fullturn.data.procedural import dog
from fullturn.data.shapes import ProceduralShapes, ShapeSource
from fullturn.data.surface import sample_surface
from fullturn.errors import InputError
from fullturn.evaluation.feature_change import (
    INVARIANT,
    StudyConfig,
    agreement,
    channel_error,
    cosine,
    describe,
    noise_error,
    pose_similarity,
    search_neighbors,
    unrelated,
)
from fullturn.evaluation.robustness import Row, by_panel, study_robustness, to_csv, to_unit_ball

# Fewer points, hence wider neighborhoods; angles near none, near a half turn, and a half turn.
SMALL = StudyConfig(points=700, normal_radius=0.2, angles_deg=(0.0, 1e-4, 35.0, 110.0, 179.9, 180))
SHIFT = torch.tensor([0.3, -0.4, 0.2], dtype=torch.float64)


class OneCloud(ShapeSource):
    """The same points at every call."""

    def __init__(self, points: np.ndarray) -> None:
        self._points = points

    def __len__(self) -> int:
        return 1

    def name(self, index: int) -> str:
        return "cloud"

    def category(self, index: int) -> str:
        return ""

    def points(self, index: int, count: int, rng: np.random.Generator) -> np.ndarray:
        return self._points

    def points_pair(self, index: int, count: int, rng: np.random.Generator):
        return self._points, self._points


def surface(n: int = 700, *, scale: float = 1.0, offset: float = 0.0) -> torch.Tensor:
    points = sample_surface(dog(), n, np.random.default_rng(4))
    return torch.from_numpy(points * scale + offset)


def lattice(jitter: float) -> torch.Tensor:
    """A box whose points stand on a grid: many neighbors are equally near, or in line."""
    rng = np.random.default_rng(0)
    points = rng.integers(0, 40, (700, 3)).astype(float)
    points[np.arange(700), rng.integers(0, 3, 700)] = rng.choice([0, 40], 700)
    points = np.unique(points, axis=0) * (1.0, 0.8, 0.6)
    return to_unit_ball(torch.from_numpy(points + 40 * jitter * rng.standard_normal(points.shape)))


class TestPose:
    @pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
    def test_invariant_features_do_not_feel_a_rotation(self, dtype):
        curves = pose_similarity(to_unit_ball(surface()).to(dtype), SHIFT.to(dtype), SMALL)
        for name in INVARIANT:
            assert min(curves["rotation", name]) >= 0.999, name
            assert curves["rotation", name][0] == pytest.approx(1, abs=1e-6)

    @pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (1e-3, 0.0), (1e3, 0.0), (1.0, 1e6)])
    def test_units_and_place_do_not_matter(self, scale, offset):
        config = replace(SMALL, angles_deg=(75.0,))
        here = pose_similarity(to_unit_ball(surface()), SHIFT, config)
        points = to_unit_ball(surface(scale=scale, offset=offset))
        there = pose_similarity(points, SHIFT, config)
        for key, values in here.items():
            # Rounding may move a pair to the next bin of a histogram.
            np.testing.assert_allclose(there[key], values, atol=1e-3, err_msg=str(key))

    @pytest.mark.parametrize("name", ["XYZ", "ΔXYZ"])
    def test_coordinates_fall_as_derived(self, name):
        # About z: v · Rv = |v|² cos θ + v_z² (1 − cos θ), summed over a point's neighbors.
        points = to_unit_ball(surface())
        values = describe(points, search_neighbors(points, SMALL), SMALL, names=(name,))[name]
        z_sq, total_sq = values[..., 2].square().sum(-1), values.square().sum((-1, -2))
        along = float((z_sq / total_sq).mean())
        turn = np.cos(np.deg2rad(SMALL.angles_deg))
        found = pose_similarity(points, SHIFT, SMALL)["rotation", name]
        np.testing.assert_allclose(found, turn + along * (1 - turn), atol=1e-9)

    def test_a_translation_costs_what_hangs_on_the_origin(self):
        curves = pose_similarity(to_unit_ball(surface()), SHIFT, SMALL)
        for name in INVARIANT:
            assert max(curves["se3", f"{name} (origin)"]) < 0.99, name
            assert min(curves["se3", f"{name} (centroid)"]) >= 0.999, name
        assert min(curves["se3", "PPF (none, folded)"]) >= 0.999
        assert min(curves["se3", "PPF (none)"]) < 0.99
        np.testing.assert_allclose(curves["se3", "ΔXYZ"], curves["rotation", "ΔXYZ"], atol=1e-6)

    def test_without_a_translation_both_panels_agree(self):
        curves = pose_similarity(to_unit_ball(surface()), 0 * SHIFT, SMALL)
        for name in INVARIANT:
            rotation = curves["rotation", name]
            np.testing.assert_allclose(curves["se3", f"{name} (origin)"], rotation, atol=1e-12)

    def test_concatenation_lies_between_its_parts(self):
        curves = pose_similarity(to_unit_ball(surface()), SHIFT, SMALL)
        coordinates = np.array(curves["rotation", "ΔXYZ"])
        for name in INVARIANT:
            raw = np.array(curves["rotation", f"{name}+XYZ+ΔXYZ"])
            equal = np.array(curves["rotation", f"{name}+XYZ+ΔXYZ (equal parts)"])
            assert (raw[2:] > equal[2:]).all()
            assert (equal[2:] > coordinates[2:]).all()

    def test_ties_on_a_lattice_are_what_bends_a_flat_line(self):
        tied = pose_similarity(lattice(0.0), SHIFT, SMALL)
        parted = pose_similarity(lattice(1e-5), SHIFT, SMALL)
        assert min(tied["rotation", "RRI"]) < 0.99
        assert min(parted["rotation", "RRI"]) > 0.9999


class TestNoise:
    def test_coordinates_feel_it_as_derived(self):
        points = to_unit_ball(surface())
        curves = noise_error(points, np.random.default_rng(0), SMALL)
        sigmas = np.array(SMALL.noise_sigmas)
        mean_abs = sigmas * math.sqrt(2 / math.pi)
        # The 2,100 coordinates have a sampling error of 1.6 %; ties of neighbors share them.
        np.testing.assert_allclose(curves["noise", "XYZ"], mean_abs, rtol=0.08)
        # The point itself is one of its neighbors, and stays at distance 0.
        share = (SMALL.neighbors - 1) / SMALL.neighbors
        expected = math.sqrt(2) * share * mean_abs
        np.testing.assert_allclose(curves["noise", "ΔXYZ"], expected, rtol=0.08)

    def test_none_changes_nothing(self):
        curves = noise_error(to_unit_ball(surface()), np.random.default_rng(0), SMALL)
        assert all(values[0] == 0 for values in curves.values())

    def test_a_whole_feature_is_the_mean_of_its_units(self):
        curves = noise_error(to_unit_ball(surface()), np.random.default_rng(0), SMALL)
        for panel in ("noise", "noise anew"):
            angles, lengths = (np.array(curves[panel, f"PPF {u}"]) for u in ("angles", "lengths"))
            np.testing.assert_allclose(curves[panel, "PPF"], (3 * angles + lengths) / 4, rtol=1e-9)

    def test_random_points_are_what_they_are(self):
        points = to_unit_ball(surface())
        curves = unrelated(points, np.random.default_rng(0), SMALL)
        difference = (points[:, None] - points[None]).abs().mean()
        assert curves["spread", "XYZ"][0] == pytest.approx(float(difference), rel=0.1)
        assert abs(curves["unrelated", "XYZ"][0]) < 0.15


class TestCosine:
    def test_agrees_with_numpy(self):
        rng = np.random.default_rng(3)
        before, after = rng.normal(size=(2, 5, 4, 3))
        extra_before, extra_after = rng.normal(size=(2, 5, 7))
        joined = np.concatenate([before.reshape(5, -1), 2 * extra_before], axis=1)
        joined_after = np.concatenate([after.reshape(5, -1), 2 * extra_after], axis=1)
        expected = np.mean(
            [
                a @ b / np.linalg.norm(a) / np.linalg.norm(b)
                for a, b in zip(joined, joined_after, strict=True)
            ]
        )
        parts = [
            agreement(torch.from_numpy(a), torch.from_numpy(b))
            for a, b in ((before, after), (extra_before, extra_after))
        ]
        assert cosine(*parts, weights=[1.0, 4.0]) == pytest.approx(expected, rel=1e-12)

    def test_zero_vectors(self):
        zero, some = torch.zeros(2, 3), torch.ones(2, 3)
        assert cosine(agreement(zero, zero)) == 1
        assert cosine(agreement(zero, some)) == 0

    def test_channel_error_keeps_units_apart(self):
        zero = {"PPF": torch.zeros(2, 3, 4)}
        one = {"PPF": torch.tensor([1.0, 2, 3, 8]).expand(2, 3, 4)}
        assert channel_error(zero, one) == {"PPF": 3.5, "PPF angles": 2.0, "PPF lengths": 8.0}


class TestStudy:
    CONFIG = replace(SMALL, points=300, angles_deg=(0.0, 90.0), noise_sigmas=(0.0, 0.05))

    def test_the_same_seed_gives_the_same_table(self):
        names: list[str] = []
        shapes = ProceduralShapes(5)
        tables = [
            to_csv(
                study_robustness(
                    shapes,
                    count=2,
                    seed=seed,
                    config=self.CONFIG,
                    on_shape=lambda number, name: names.append(f"{number} {name}"),
                )
            )
            for seed in (1, 1, 2)
        ]
        assert tables[0] == tables[1] != tables[2]
        assert names[:2] == [f"1 {shapes.name(0)}", f"2 {shapes.name(4)}"]
        table = list(csv.DictReader(io.StringIO(tables[0])))
        assert list(table[0]) == ["panel", "feature", "x", "value", "low", "high"]
        assert {row["x"] for row in table if row["panel"] == "rotation"} == {"0", "90"}
        assert {row["x"] for row in table if row["panel"] == "unrelated"} == {""}

    def test_relative_errors_weigh_the_channels_alike(self):
        rows = study_robustness(ProceduralShapes(2), count=2, config=self.CONFIG)
        panels = by_panel(rows)
        relative = {k: v[1] for k, v in panels["noise, relative"].items()}
        expected = (3 * relative["PPF angles"] + relative["PPF lengths"]) / 4
        np.testing.assert_allclose(relative["PPF"], expected)
        ratio = panels["noise"]["XYZ"][1] / panels["spread"]["XYZ"][1]
        np.testing.assert_allclose(relative["XYZ"], ratio)

    @pytest.mark.parametrize("kind", ["planar", "collinear", "duplicate", "4 points"])
    def test_degenerate_clouds_are_studied_too(self, kind):
        rng = np.random.default_rng(0)
        points = {
            "planar": rng.uniform(size=(200, 3)) * (1, 1, 0),
            "collinear": rng.normal(size=(200, 1)) * np.ones(3),
            "duplicate": rng.normal(size=(50, 3))[rng.integers(0, 50, 200)],
            "4 points": rng.normal(size=(4, 3)),
        }[kind]
        rows = study_robustness(OneCloud(points), count=1, config=self.CONFIG)
        for row in rows:
            relative = row.panel.endswith("relative")
            assert math.isfinite(row.value) or relative, row
        flat = [r.value for r in rows if (r.panel, r.feature) == ("noise, relative", "PPF")]
        assert math.isnan(flat[0]) == (kind == "planar"), flat

    def test_what_cannot_be_studied_is_named(self):
        with pytest.raises(InputError, match="at least 1, got 0"):
            study_robustness(ProceduralShapes(1), count=0)
        with pytest.raises(InputError, match="all of them coincide"):
            study_robustness(OneCloud(np.ones((9, 3))), count=1)

    def test_an_unknown_number_is_an_empty_cell(self):
        row = Row("unrelated", "XYZ", math.nan, 1 / 3, 0.0, 1.0)
        assert to_csv([row]).splitlines()[1] == "unrelated,XYZ,,0.333333,0,1"


class TestDocumentedFindings:
    """docs/robustness.md says this in words; its table has to say so, too."""

    @pytest.fixture
    def values(self) -> dict[tuple[str, str], np.ndarray]:
        path = Path(__file__).parents[2] / "docs" / "robustness.csv"
        found: dict[tuple[str, str], list[float]] = {}
        with path.open(encoding="utf-8") as file:
            for row in csv.DictReader(file):
                found.setdefault((row["panel"], row["feature"]), []).append(float(row["value"]))
        return {key: np.array(column) for key, column in found.items()}

    def test_invariance_and_its_loss(self, values):
        for name in INVARIANT:
            assert values["rotation", name].min() > 0.999
            assert values["se3", f"{name} (centroid)"].min() > 0.999
            # A flat line.
            assert np.ptp(values["se3", f"{name} (origin)"]) < 0.01
        lost = {
            name: (1 - values["se3", f"{name} (origin)"][-1]) / (1 - values["unrelated", name][0])
            for name in INVARIANT
        }
        assert {name: round(100 * share) for name, share in lost.items()} == {
            "PPF": 55,
            "RRI": 51,
            "FPFH": 24,
        }

    def test_concatenation_is_a_matter_of_units(self, values):
        equal = "PPF+XYZ+ΔXYZ (equal parts)"
        assert values["rotation", "PPF+XYZ+ΔXYZ"][-1] == pytest.approx(0.93, abs=0.005)
        assert values["rotation", equal][-1] < values["unrelated", equal][0]

    def test_noise(self, values):
        near, far = (
            {k: values["noise, relative", k][i] for _, k in values if ("spread", k) in values}
            for i in (1, 5)
        )
        local = ("PPF angles", "RRI angles", "FPFH")
        assert near["XYZ"] < near["ΔXYZ"] < min(near[name] for name in local)
        assert max(far[name] for name in local) < far["ΔXYZ"] < far["PPF lengths"]
        assert values["noise", "RRI lengths"] == pytest.approx(values["noise", "XYZ"], rel=0.01)
