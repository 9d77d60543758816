"""Line styles of controllers: a colour, dash and marker for each, the same in every figure."""

import math
from collections.abc import Sequence
from typing import Any, Final

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vergence.eval.comparison.contestants import BASELINE, BOUND
from vergence.models.parts import FloatArray
from vergence.reporting.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    label_lines,
    legend_below,
)

Values = FloatArray | pd.Series
"""(n,) values of a line or a column of a table."""

_REGISTRY_STYLES: Final[dict[str, dict[str, Any]]] = {
    BOUND: {"color": BLACK, "linestyle": (0, (1, 1)), "marker": "|"},
    BASELINE: {"color": BLACK, "linestyle": "-", "marker": "o"},
    "ibvs": {"color": GREY, "linestyle": "-", "marker": "v"},
    "adaptive": {"color": "#9a6a00", "linestyle": "--", "marker": "D"},
    "pid": {"color": "#c2458b", "linestyle": "-.", "marker": "^"},
    "fuzzy": {"color": PURPLE, "linestyle": (0, (6, 2)), "marker": "P"},
    "delay-compensated": {"color": BLUE, "linestyle": "--", "marker": "s"},
    "state-feedback": {"color": "#6b4c35", "linestyle": (0, (4, 1, 1, 1)), "marker": "p"},
    "saccade": {"color": ORANGE, "linestyle": "-", "marker": "*"},
    "pursuit": {"color": GREEN, "linestyle": "-.", "marker": "X"},
    "learned-gain": {"color": "#2bb3b0", "linestyle": (0, (3, 1, 1, 1)), "marker": "<"},
    "learned-policy": {"color": "#b0122e", "linestyle": (0, (8, 2, 2, 2)), "marker": ">"},
}
# colours, dashes (in line widths) and markers of controllers outside the registry (chosen)
_COLORS: Final = ("#5b8c00", "#0072b2", "#e08a00", "#8a3ffc", "#d02670", "#007d79", "#a2191f")
_DASHES: Final = ((0, (4, 1)), (0, (2, 1)), (0, (5, 1, 1, 1)), (0, (3, 3)), (0, (7, 1)))
_MARKERS: Final = ("h", "d", "8", "H", "1", "2")


def controller_styles(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Line styles by controller, the label included.

    Args:
        names: the controllers; those outside the registry get further styles in order.

    Returns:
        Keyword arguments of `Axes.plot`.
    """
    styles = {}
    strangers = 0
    for name in names:
        style = _REGISTRY_STYLES.get(name)
        if style is None:
            style = {
                "color": _COLORS[strangers % len(_COLORS)],
                "linestyle": _DASHES[strangers % len(_DASHES)],
                "marker": _MARKERS[strangers % len(_MARKERS)],
            }
            strangers += 1
        styles[name] = {**style, "label": name}
    return styles


def draw_line(
    axes: Axes, x: Values, y: Values, style: dict[str, Any], line_index: int, **more: Any
) -> None:
    """Draw a line with a few markers, which are shifted from line to line.

    Args:
        axes: axes to draw in.
        x: (n,) abscissae.
        y: (n,) ordinates.
        style: line style of the controller.
        line_index: index of the line in the figure.
        **more: overrides of the style.
    """
    every = max(1, len(x) // 6)
    start = (line_index * every) // 7 % every
    axes.plot(x, y, markevery=(start, every), **{"linewidth": 1.6, **style, **more})


def name_lines(figure: Figure, *panels: Axes) -> None:
    """Name the lines next to them, in the panel with the most room, or else in a legend."""
    figure.draw_without_rendering()  # computes the layout
    if label_lines(*panels, fontsize=10):
        return
    count = len(panels[0].get_legend_handles_labels()[1])
    columns = min(count, 4)
    figure.set_figheight(figure.get_figheight() + 0.27 * math.ceil(count / columns))
    legend_below(figure, columns, handlelength=3.2)
