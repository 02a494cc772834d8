"""Figures without a window and without global state."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fullturn.errors import DependencyError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# What a figure's suffix may be. No date: the same input gives the same bytes.
METADATA: dict[str, dict[str, str | None] | None] = {
    ".png": {"Software": "fullturn"},
    ".pdf": {"Creator": "fullturn", "CreationDate": None},
    ".svg": {"Creator": "fullturn", "Date": None},
    ".jpg": None,
    ".jpeg": None,
}


def check_installed() -> None:
    """Say what is missing, before any work.

    Raises:
        DependencyError: matplotlib is missing (``pip install "fullturn[viz]"``).
    """
    try:
        import matplotlib.backends.backend_agg
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise DependencyError(
            'a picture needs matplotlib, which is not installed; pip install "fullturn[viz]"'
        ) from error


def new_figure(**options: Any) -> Figure:
    """An empty white figure that can be saved; options as of `matplotlib.figure.Figure`.

    Raises:
        DependencyError: matplotlib is missing.
    """
    check_installed()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(facecolor="white", **options)
    FigureCanvasAgg(figure)
    return figure
