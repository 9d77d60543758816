"""Common style of all figures, readable in greyscale, on phones and on paper."""

import io
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Final

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation

BLUE: Final = "#1f6fb4"
ORANGE: Final = "#d1571b"
GREEN: Final = "#14803c"
PURPLE: Final = "#7a4fa3"
BLACK: Final = "#222222"
GREY: Final = "#777777"

METHOD_STYLE: Final[dict[str, dict[str, Any]]] = {
    "gaze": {"color": BLUE, "marker": "o", "linestyle": "-", "label": "gaze"},
    "itpc": {"color": ORANGE, "marker": "s", "linestyle": "--", "label": "ITPC"},
}
"""Line styles of the two methods, with different markers and dashes as well as colours."""
ARTICLE_STYLE: Final[dict[str, Any]] = {"color": BLACK, "linestyle": ":", "linewidth": 1.3}
"""Line style of the article's values."""
ARTICLE_BAND: Final[dict[str, Any]] = {"color": GREY, "alpha": 0.18, "linewidth": 0.0}
"""Style of a range of the article's values."""

_AXIS_LABEL_IN: Final = 0.45
"""Height of a horizontal axis with its numbers and label, inches (measured on the font's size)."""
_RC: Final[Any] = {
    "font.size": 11,
    "axes.titlesize": 12,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
    "lines.markersize": 5,
    "svg.hashsalt": "vergence",
    "svg.fonttype": "none",
    "figure.dpi": 110,
}


def new_figure(width: float = 9.0, height: float = 4.2) -> Figure:
    """Make an empty figure, with sizes in inches; draw it inside `figure_style`."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def log_axis(panel: Axes, which: str = "y") -> None:
    """Make an axis, x or y, logarithmic with plain numbers; more of them over few decades."""
    panel.set(**{f"{which}scale": "log"})
    axis = panel.xaxis if which == "x" else panel.yaxis

    def minor(value: float, _: object) -> str:
        decades = abs(np.subtract(*np.log10(axis.get_view_interval())))
        marked = () if decades > 2.2 else (2, 5) if decades > 1.1 else (2, 3, 5, 7)
        digit = round(value / 10.0 ** np.floor(np.log10(value) + 1e-9))
        return f"{value:g}" if digit in marked else ""

    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(minor)


def legend_below(of: Figure | Axes, columns: int, **options: Any) -> None:
    """Add a legend below a panel, or one below a figure for all its panels, each label once.

    Args:
        of: a figure, or a panel with its own legend.
        columns: number of columns of the legend.
        options: further options of `Figure.legend` or `Axes.legend`.
    """
    place: dict[str, Any] = {"loc": "outside lower center"}
    if isinstance(of, Axes):
        shift = ScaledTranslation(0.0, -_AXIS_LABEL_IN, of.figure.dpi_scale_trans)
        place = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0),
                 "bbox_transform": of.transAxes + shift}  # fmt: skip
    handles: dict[str, Any] = {}
    for panel in [of] if isinstance(of, Axes) else of.axes:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    of.legend(handles.values(), handles.keys(), ncols=columns, **{**place, **options})


def figure_style() -> AbstractContextManager[None]:
    """Context for drawing and saving figures in this style."""
    return matplotlib.rc_context(_RC)


def save_figure(figure: Figure, stem: Path) -> None:
    """Write a figure as `stem`.svg and `stem`.png; equal figures give equal bytes."""
    with figure_style():
        figure.draw_without_rendering()  # panels with equal axes fit only after a second layout
        figure.savefig(stem.with_suffix(".svg"), metadata={"Date": None})
        figure.savefig(stem.with_suffix(".png"), dpi=110, metadata={"Software": None})


def svg_text(figure: Figure) -> str:
    """Render a figure as the text of an SVG file."""
    text = io.StringIO()
    with figure_style():
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()
