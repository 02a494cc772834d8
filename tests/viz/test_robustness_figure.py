"""The picture of the feature study: every curve is drawn and named, no label hides another."""

from __future__ import annotations

import itertools
import subprocess
import sys

import numpy as np
import pytest

from fullturn.errors import DependencyError, InputError, WriteError
from fullturn.viz.robustness import NOISE, POSE, draw_robustness, save_robustness, spread_labels


@pytest.fixture
def panels() -> dict[str, dict[str, np.ndarray]]:
    angles, sigmas = np.linspace(0, 180, 5), np.linspace(0, 0.1, 4)
    made: dict[str, dict[str, np.ndarray]] = {"unrelated": {}}
    for line in POSE:
        level = np.full(5, 0.999)  # the hardest case: all end at one height
        made.setdefault(line.panel, {})[line.feature] = np.stack([angles, level, level, level])
    for panel, (feature, _, _) in itertools.product(("noise", "noise, relative"), NOISE):
        made.setdefault(panel, {})[feature] = np.stack([sigmas, 3 * sigmas, sigmas, 4 * sigmas])
    for name in ("RRI", "PPF", "FPFH"):
        made["unrelated"][name] = np.array([[np.nan], [0.7], [0.6], [0.8]])
    return made


def extent(annotation):
    """Where the words of an annotation are, without its line."""
    from matplotlib.text import Text

    return Text.get_window_extent(annotation)


def test_missing_matplotlib_is_named(panels, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    with pytest.raises(DependencyError, match=r'pip install "fullturn\[viz\]"'):
        save_robustness(tmp_path / "a.png", panels)
    assert list(tmp_path.iterdir()) == []


def test_matplotlib_comes_only_when_a_picture_is_drawn():
    code = "import sys, fullturn.viz.robustness; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


class TestLabels:
    @pytest.mark.parametrize("seed", range(20))
    def test_order_and_gap_are_kept(self, seed):
        rng = np.random.default_rng(seed)
        heights = rng.uniform(size=rng.integers(1, 12)).round(1)
        places = spread_labels(heights, 0.15)
        order = np.argsort(heights, kind="stable")
        assert (np.diff(places[order]) >= 0.15 - 1e-12).all()
        assert places.mean() == pytest.approx(heights.mean())

    def test_they_are_the_nearest_such_places(self):
        from scipy.optimize import minimize

        heights = np.array([0.1, 0.1, 0.15, 0.5, 0.52, 0.9])
        gaps = {"type": "ineq", "fun": lambda y: np.diff(y) - 0.1}
        best = minimize(
            lambda y: ((y - heights) ** 2).sum(), np.linspace(0, 1, 6), constraints=[gaps]
        )
        np.testing.assert_allclose(spread_labels(heights, 0.1), best.x, atol=1e-4)

    def test_what_is_apart_stays(self):
        assert spread_labels([3.0, 1.0, 2.0], 0.5).tolist() == [3.0, 1.0, 2.0]


class TestWithMatplotlib:
    @pytest.fixture(autouse=True)
    def _matplotlib(self):
        pytest.importorskip("matplotlib")

    def test_every_curve_has_its_name_and_no_two_overlap(self, panels):
        figure = draw_robustness(panels)
        figure.canvas.draw()
        for axes, lines in zip(figure.axes, (POSE, NOISE, NOISE), strict=True):
            labels = [text for text in axes.texts if hasattr(text, "arrow_patch")]
            assert [text.get_text() for text in labels] == [line[-2] for line in lines]
            boxes = [extent(text) for text in labels]
            for one, other in itertools.combinations(boxes, 2):
                assert abs(one.y0 - other.y0) > 0.95 * min(one.height, other.height)
            assert max(box.x1 for box in boxes) < figure.bbox.x1
            assert max(box.y1 for box in boxes) < figure.bbox.y1

    def test_labels_point_to_where_the_curves_end(self, panels):
        figure = draw_robustness(panels)
        figure.canvas.draw()
        for axes, count in zip(figure.axes, (len(POSE), len(NOISE), len(NOISE)), strict=True):
            labels = [text for text in axes.texts if hasattr(text, "arrow_patch")]
            for line, label in zip(axes.lines[:count], labels, strict=True):
                end = axes.transData.transform(line.get_xydata()[-1])
                pointed = axes.transAxes.transform(label.xy)
                np.testing.assert_allclose(pointed, end, atol=0.01)

    def test_no_label_reaches_into_the_next_panel(self, panels):
        figure = draw_robustness(panels)
        figure.canvas.draw()
        pose, raw, relative = figure.axes
        right = max(extent(text).x1 for text in pose.texts)
        left = min(axes.yaxis.get_tightbbox().x0 for axes in (raw, relative))
        assert right < left

    @pytest.mark.parametrize(
        ("suffix", "begin"), [(".png", b"\x89PNG"), (".pdf", b"%PDF"), (".svg", b"<?xml")]
    )
    def test_suffix_chooses_the_format(self, panels, tmp_path, suffix, begin):
        path = tmp_path / f"figure{suffix}"
        save_robustness(path, panels, dpi=40)
        assert path.read_bytes().startswith(begin)

    def test_same_input_gives_the_same_picture(self, panels, tmp_path):
        for name in ("a.png", "b.png"):
            save_robustness(tmp_path / name, panels, dpi=40)
        assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()

    def test_a_feature_without_values_has_no_name_either(self, panels):
        panels["noise, relative"]["PPF angles"][1:] = np.nan
        _, raw, relative = draw_robustness(panels).axes
        assert "PPF angles" in {text.get_text() for text in raw.texts}
        assert "PPF angles" not in {text.get_text() for text in relative.texts}

    def test_errors_leave_no_file(self, panels, tmp_path):
        with pytest.raises(WriteError, match="svg"):
            save_robustness(tmp_path / "a.bmp", panels)
        with pytest.raises(InputError, match="x, value, low, high"):
            save_robustness(tmp_path / "a.png", panels | {"unrelated": {"RRI": np.zeros(3)}})
        del panels["se3"]
        with pytest.raises(InputError, match=r"'RRI \(origin\)' in the panel 'se3'"):
            save_robustness(tmp_path / "a.png", panels)
        assert list(tmp_path.iterdir()) == []
