"""Pictures of any cloud, without a window and without global state."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from fullturn.errors import DependencyError, InputError, WriteError
from fullturn.viz.figures import beside, draw_figure, headline, save_figure


def test_missing_matplotlib_is_named(make_pair, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    with pytest.raises(DependencyError, match=r'pip install "fullturn\[viz\]"'):
        save_figure(tmp_path / "a.png", *make_pair())
    assert list(tmp_path.iterdir()) == []


def test_source_stands_to_the_left_of_the_target():
    rng = np.random.default_rng(0)
    for scale, offset in ((1.0, 0.0), (1e-3, 5.0), (1e5, 1e6)):
        source, target = rng.normal(size=(2, 50, 3)) * scale + offset
        moved = beside(source + 3 * scale, target)
        assert moved[:, 0].max() < target[:, 0].min()
        np.testing.assert_allclose(np.ptp(moved, axis=0), np.ptp(source, axis=0), rtol=1e-6)


def test_headline_names_rotation_probability_and_overlap(make_pair):
    _, _, result = make_pair()
    line = headline(result)
    assert "probability 0.80" in line
    assert "75 % of the source and 80 % of the target" in line
    assert line.startswith("Rotation 1")


class TestWithMatplotlib:
    @pytest.fixture(autouse=True)
    def _matplotlib(self):
        pytest.importorskip("matplotlib")

    def test_any_cloud_gives_a_picture(self, make_pair, shape, tmp_path):
        from matplotlib.image import imread

        path = tmp_path / "figure.png"
        save_figure(path, *make_pair(shape, count=100), dpi=60)
        picture = imread(path)
        assert picture.shape[1] == 780
        assert 60 * 3.3 <= picture.shape[0] <= 60 * 5.5
        assert picture[..., :3].mean() < 0.999  # something is drawn

    def test_panels_have_one_scale(self, make_pair):
        figure = draw_figure(*make_pair())
        figure.canvas.draw()
        scales = [axes.transData.transform([(0, 0), (1, 1)]) for axes in figure.axes]
        per_unit = np.array([corner[1] - corner[0] for corner in scales])
        np.testing.assert_allclose(per_unit, per_unit[0, 0], rtol=0.12)
        np.testing.assert_allclose(per_unit[:, 0], per_unit[:, 1], rtol=1e-6)
        assert [axes.get_title() for axes in figure.axes] == ["Before", "After", "Overlap"]

    @pytest.mark.parametrize(
        ("suffix", "begin"),
        [
            (".png", b"\x89PNG"),
            (".pdf", b"%PDF"),
            (".svg", b"<?xml"),
            (".jpg", b"\xff\xd8"),
            (".JPEG", b"\xff\xd8"),
        ],
    )
    def test_suffix_chooses_the_format_and_equal_input_gives_equal_bytes(
        self, make_pair, tmp_path, suffix, begin
    ):
        places = [tmp_path / f"{name}{suffix}" for name in "ab"]
        for path in places:
            save_figure(path, *make_pair(count=40), dpi=50)
        first, second = (path.read_bytes() for path in places)
        assert first.startswith(begin)
        assert first == second

    def test_errors_leave_no_file(self, make_pair, tmp_path):
        source, target, result = make_pair()
        with pytest.raises(WriteError, match="svg"):
            save_figure(tmp_path / "figure.bmp", source, target, result)
        with pytest.raises(InputError):
            save_figure(tmp_path / "figure.png", source[:, :2], target, result)
        assert list(tmp_path.iterdir()) == []

    def test_pyplot_stays_out(self, tmp_path):
        code = (
            "import sys, numpy as np\n"
            "from fullturn.viz import figures\n"
            "assert 'matplotlib' not in sys.modules\n"
            "from matplotlib.backends.backend_agg import FigureCanvasAgg\n"
            "sys.exit('matplotlib.pyplot' in sys.modules)\n"
        )
        assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
