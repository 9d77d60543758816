"""The figure of margins: a panel for each imperfection, a bar for each controller."""

import math
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from vergence.eval.comparison.style import controller_styles
from vergence.eval.margins.margins import RANGE_ENDS, Margin, Margins
from vergence.eval.margins.ranges import IMPERFECTION_RANGES
from vergence.eval.margins.tables import imperfection_title
from vergence.reporting.style import BLACK, GREY, figure_style, new_figure

_MOST_COLUMNS: Final = 4
"""Most panels side by side (chosen: legibility)."""
_FULL_WIDTH_IN: Final = 13.0
"""Width of a figure with all columns, inches (chosen: legibility)."""
_AXIS_MARGIN: Final = 0.05
"""Margin of the axis on either side, as a fraction of the searched range (chosen: legibility)."""


def margin_figures(margins: Margins) -> dict[str, Figure]:
    """Draw a figure for each scenario, by name.

    Args:
        margins: the margins.
    """
    with figure_style():
        return {
            f"margins-{scenario}": _draw(found, scenario)
            for scenario, found in margins.by_scenario().items()
        }


def _draw(found: list[Margin], scenario: str) -> Figure:
    controllers = list(dict.fromkeys(one.controller for one in found))
    names = list(dict.fromkeys(one.imperfection for one in found))
    columns = min(_MOST_COLUMNS, len(names))
    rows = math.ceil(len(names) / columns)
    height = rows * (0.85 + 0.27 * len(controllers)) + 0.9
    figure = new_figure(_FULL_WIDTH_IN * max(columns, 2) / _MOST_COLUMNS, height)
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    styles = controller_styles(controllers)
    for panel, name in zip(panels, names, strict=False):
        own = [one for one in found if one.imperfection == name]
        for one in own:
            _draw_bar(panel, one, controllers.index(one.controller), styles[one.controller])
        _dress(panel, own)
    for panel in panels[len(names) :]:
        panel.set_visible(False)
    panels[0].set_yticks(range(len(controllers)), controllers)
    panels[0].set_ylim(len(controllers) - 0.4, -0.6)
    figure.suptitle(f"Margins, one imperfection at a time: {scenario}", fontsize=13)
    figure.legend(handles=_legend(), loc="outside lower center", ncols=5 if columns > 2 else 2)
    return figure


def _draw_bar(panel: Axes, one: Margin, place: int, style: dict[str, object]) -> None:
    """Draw a wide light bar for the range "doubles" and a narrow dark one for "settles"."""
    color, scale = style["color"], IMPERFECTION_RANGES[one.imperfection].scale
    for kind, height, alpha in (("doubles", 0.74, 0.3), ("settles", 0.34, 1.0)):
        low, high = (getattr(one, f"{kind}_{end}") for end in ("low", "high"))
        if low is None:
            if kind == "settles":
                panel.plot([scale * one.range.expected], [place], "x", color=color, markersize=7)
            continue
        panel.barh(
            place, scale * (high - low), left=scale * low, height=height, color=color, alpha=alpha,
            # the edge keeps a range of zero width visible as a line
            edgecolor=color, linewidth=1.0, zorder=2 if kind == "doubles" else 3,
        )  # fmt: skip
    for end in RANGE_ENDS[:2]:
        if one.is_open(end):
            marker = "<" if end.endswith("low") else ">"
            panel.plot(
                [scale * getattr(one, end)], [place], marker, color=color, markersize=7,
                clip_on=False, zorder=4,
            )  # fmt: skip


def _dress(panel: Axes, own: list[Margin]) -> None:
    scale = IMPERFECTION_RANGES[own[0].imperfection].scale
    low = scale * min(one.range.low for one in own)
    high = scale * max(one.range.high for one in own)
    room = _AXIS_MARGIN * (high - low)
    panel.set_xlim(low - room, high + room)
    panel.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))
    panel.axvline(scale * own[0].range.expected, color=BLACK, linestyle=":", linewidth=1.3)
    panel.set_title(imperfection_title(own[0].imperfection), fontsize=11)
    panel.tick_params(axis="y", length=0)
    panel.grid(visible=False, axis="y")
    panel.spines["left"].set_visible(False)


def _legend() -> list[Patch | Line2D]:
    return [
        Patch(color=GREY, label="99 % settle"),
        Patch(color=GREY, alpha=0.3, label="median not doubled"),
        Line2D([], [], color=BLACK, linestyle=":", linewidth=1.3, label="expected"),
        Line2D([], [], color=GREY, marker=">", linestyle="none", label="end of the search"),
        Line2D([], [], color=GREY, marker="x", linestyle="none", label="settles nowhere"),
    ]
