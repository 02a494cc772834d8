"""Curves over many pairs: that they show their numbers, and any number can be shown."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from fullturn.errors import DependencyError, InputError, WriteError
from fullturn.viz.curves import COLORS, draw_error_curves, draw_risk_coverage, save_curves


def errors(count: int = 50, seed: int = 0) -> np.ndarray:
    return 10.0 ** np.random.default_rng(seed).uniform(-3, 2.2, count)


def test_missing_matplotlib_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    with pytest.raises(DependencyError, match=r'pip install "fullturn\[viz\]"'):
        draw_error_curves({"a": {"one": errors()}})
    with pytest.raises(DependencyError):
        draw_risk_coverage({}, {})


class TestWithMatplotlib:
    @pytest.fixture(autouse=True)
    def _matplotlib(self):
        pytest.importorskip("matplotlib")

    def test_the_curve_is_the_share_below(self) -> None:
        angles = errors(200)
        figure = draw_error_curves({"a": {"one": angles}})
        x, y = figure.axes[0].lines[0].get_data()
        for limit in (0.02, 0.5, 5.0, 60.0):
            assert y[np.searchsorted(x, limit, side="right") - 1] == np.mean(angles <= limit)

    def test_failures_keep_the_curve_down(self) -> None:
        figure = draw_error_curves({"a": {"one": np.array([1.0, np.inf, np.inf, 0.0])}})
        x, y = figure.axes[0].lines[0].get_data()
        assert y[-1] == 0.5
        assert np.isfinite(x).all()
        assert figure.axes[0].texts[0].get_text() == "one 50 %"

    @pytest.mark.parametrize("sets", [1, 2, 3, 4, 5, 15])
    def test_one_panel_a_set(self, sets: int) -> None:
        names = [f"set {i}" for i in range(sets)]
        figure = draw_error_curves({name: {"one": errors()} for name in names})
        shown = [axes for axes in figure.axes if axes.get_visible()]
        assert [axes.get_title(loc="left") for axes in shown] == names

    def test_methods_keep_color_and_order_in_every_panel(self) -> None:
        figure = draw_error_curves(
            {"a": {"one": errors(), "two": errors()}, "b": {"two": errors(), "three": errors()}}
        )
        first, second = (axes.lines for axes in figure.axes)
        assert [line.get_color() for line in first[:2]] == list(COLORS[:2])
        assert [line.get_color() for line in second[:2]] == list(COLORS[1:3])

    def test_many_methods_are_told_apart(self) -> None:
        figure = draw_error_curves({"a": {str(i): errors(seed=i) for i in range(16)}})
        lines = figure.axes[0].lines[:16]
        # A pattern of dashes has no public getter.
        styles = {(line.get_color(), str(line._dash_pattern)) for line in lines}
        assert len(styles) == 16

    def test_labels_do_not_overlap_and_stay_in_the_panel(self) -> None:
        methods = {f"method {i}": np.full(10, 0.1) for i in range(8)}
        methods["bad"] = np.full(10, 90.0)
        figure = draw_error_curves({"a": methods})
        heights = sorted(text.xy[1] for text in figure.axes[0].texts)
        assert np.diff(heights).min() > 0.08
        assert 0.0 <= heights[0] <= heights[-1] <= 1.0
        named = {text.get_text(): text.xy[1] for text in figure.axes[0].texts}
        assert named["method 0 100 %"] == max(heights)  # equal ones in the order given

    def test_the_published_mean_is_marked(self) -> None:
        figure = draw_error_curves(
            {"a": {"one": errors()}, "b": {"one": errors()}}, published={"b": ("GMCNet", 18.13)}
        )
        texts = [[text.get_text() for text in axes.texts] for axes in figure.axes]
        assert "GMCNet: mean 18.13°" in texts[1]
        assert len(texts[0]) == 1

    def test_methods_without_pairs_are_left_out(self) -> None:
        empty = np.zeros(0)
        figure = draw_error_curves({"a": {"one": errors(), "two": empty}, "b": {"one": empty}})
        assert len([axes for axes in figure.axes if axes.get_visible()]) == 1
        with pytest.raises(InputError, match="got none"):
            draw_error_curves({"b": {"one": empty}})
        with pytest.raises(InputError):
            draw_risk_coverage({}, {})

    def test_risk_and_reliability(self) -> None:
        coverage, risk = np.arange(1, 5) / 4, np.array([0.0, 0.0, 1 / 3, 0.5])
        bins = (np.array([0.2, 0.9]), np.array([0.0, 1.0]), np.array([1.0, 3.0]))
        figure = draw_risk_coverage({"a": {"one": (coverage, risk)}}, {"one": bins})
        curve, diagram = figure.axes
        np.testing.assert_array_equal(curve.lines[0].get_data(), (coverage, risk))
        assert curve.texts[0].get_text() == "one 50 %"
        np.testing.assert_array_equal(diagram.lines[1].get_data(), bins[:2])

    def test_same_input_gives_the_same_bytes(self, tmp_path) -> None:
        for name in ("a.png", "b.png"):
            figure = draw_error_curves({"a": {"one": errors()}})
            save_curves(tmp_path / name, figure, dpi=50)
        assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
        with pytest.raises(WriteError, match="svg"):
            save_curves(tmp_path / "a.bmp", figure)
