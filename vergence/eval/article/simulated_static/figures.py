"""The figures of the static targets on the simulated rig."""

from typing import Any, Final

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vergence.eval.article.common.simulated_cases import CASES
from vergence.eval.article.reported import static_points
from vergence.eval.article.simulated_static.findings import (
    ARTICLE_CASE,
    ARTICLE_DETECTION_PX,
    ARTICLE_Z_PERCENT,
    XY_WORST_MM,
    Z_WORST_PERCENT,
    article_result,
    detection_noise_px,
    implied_noise_px,
    select_fixes,
)
from vergence.eval.article.simulated_static.trials import SimulatedStaticConfig
from vergence.reporting.style import (
    ARTICLE_BAND,
    ARTICLE_STYLE,
    BLUE,
    GREEN,
    METHOD_STYLE,
    ORANGE,
    PURPLE,
    figure_style,
    legend_below,
    log_axis,
    new_figure,
)

_CASE_STYLE: Final[dict[str, dict[str, Any]]] = {
    "exact": {"color": GREEN, "linestyle": "-"},
    "principal": {"color": BLUE, "linestyle": "--"},
    "drawn": {"color": ORANGE, "linestyle": "-."},
}
_UNCERTAINTIES: Final[tuple[tuple[str, str, dict[str, Any]], ...]] = (
    ("gaze", "uncertainty_mm", {"label": "gaze, Eqs. 27 to 33"}),
    ("itpc", "uncertainty_mm",
     {"label": "ITPC, Eqs. 34 to 36", "linestyle": "", "marker": "s", "markerfacecolor": "none"}),
    ("gaze", "standard_deviation_mm",
     {"label": "gaze, scatter of the closed loop", "linestyle": "-.", "marker": "o"}),
    ("itpc", "standard_deviation_mm",
     {"label": "ITPC, scatter of the closed loop", "linestyle": ":"}),
)  # fmt: skip
"""Curves of Figure 7: method, column and line style."""
_LEAST_MM: Final = 1e-4
"""Smallest error drawn on the logarithmic axis, mm; smaller ones are raised to it (numerical)."""


def draw(table: pd.DataFrame, config: SimulatedStaticConfig) -> dict[str, Figure]:
    """The figures by name."""
    with figure_style():
        return {
            "fig06-absolute-errors": _errors(table),
            "fig06-dithered-fixation": _dithered(table),
            "fig07-uncertainties": _uncertainties(table),
            "fig07-implied-detection-noise": _implied(table),
        }


def _panels(figure: Figure, unit: str) -> list[Axes]:
    axes = list(figure.subplots(1, 3))
    for axis, letter in zip(axes, "xyz", strict=True):
        axis.set_title(letter)
        axis.set_xlabel("depth (m)")
        log_axis(axis)
    axes[0].set_ylabel(unit)
    return axes


def _by_depth(rows: pd.DataFrame, method: str, axis: str, column: str) -> tuple[Any, Any]:
    own = rows[(rows["method"] == method) & (rows["axis"] == axis)].sort_values("depth_mm")
    return own["depth_mm"] / 1000.0, own[column].abs().clip(lower=_LEAST_MM)


def _errors(table: pd.DataFrame) -> Figure:
    figure = new_figure(9.5, 5.0)
    axes = _panels(figure, "absolute error of the mean (mm)")
    depth = static_points("simulated")[:, 2]
    for axis, letter in zip(axes, "xyz", strict=True):
        if letter == "z":
            label = f"article: {ARTICLE_Z_PERCENT:g} % of depth"
            axis.plot(depth, 10.0 * ARTICLE_Z_PERCENT * depth, **ARTICLE_STYLE, label=label)
            least = article_result("absolute error", "z", "gaze").low
            axis.plot(1.1, least, marker="*", markersize=9, linestyle="", color="black",
                      label="article's least")  # fmt: skip
        else:
            axis.axhspan(
                *article_result("absolute error", letter).span,
                **ARTICLE_BAND,
                label="article's range",
            )
        for case in CASES:
            style = _CASE_STYLE.get(case, {"color": PURPLE, "linestyle": ":"})
            rows = select_fixes(table, case)
            title = CASES[case].title
            axis.plot(*_by_depth(rows, "gaze", letter, "error_mm"), **style, label=f"{title}, gaze")
            axis.plot(
                *_by_depth(rows, "itpc", letter, "error_mm"), linestyle="", marker="s",
                markerfacecolor="none", color=style["color"], label=f"{title}, ITPC",
            )  # fmt: skip
    legend_below(figure, 3)
    return figure


def _dithered(table: pd.DataFrame) -> Figure:
    figure = new_figure(9.5, 4.4)
    axes = _panels(figure, "absolute error of the mean (mm)")
    depth = static_points("simulated")[:, 2]
    for axis, letter in zip(axes, "xyz", strict=True):
        worst = 10.0 * Z_WORST_PERCENT * depth if letter == "z" else XY_WORST_MM + 0.0 * depth
        axis.plot(depth, worst, **ARTICLE_STYLE, label="our target, still")
        axis.plot(depth, 0.5 * worst, color="black", linewidth=1.0, label="our target, dithered")
        for fixation, colour, marker in (("still", BLUE, "o"), ("dithered", GREEN, "^")):
            rows = select_fixes(table, "exact", fixation)
            axis.plot(
                *_by_depth(rows, "itpc", letter, "error_mm"), color=colour, marker=marker,
                linestyle="-" if fixation == "still" else "--", label=f"{fixation} fixation, ITPC",
            )  # fmt: skip
    legend_below(figure, 2)
    return figure


def _uncertainties(table: pd.DataFrame) -> Figure:
    figure = new_figure(9.5, 5.0)
    axes = _panels(figure, "uncertainty, standard deviation (mm)")
    rows = select_fixes(table, ARTICLE_CASE)
    for axis, letter in zip(axes, "xyz", strict=True):
        axis.axhspan(
            *article_result("uncertainty", letter).span, **ARTICLE_BAND, label="article's range"
        )
        for method, column, style in _UNCERTAINTIES:
            color = METHOD_STYLE[method]["color"]
            axis.plot(*_by_depth(rows, method, letter, column), color=color, **style)
    legend_below(figure, 3)
    return figure


def _implied(table: pd.DataFrame) -> Figure:
    figure = new_figure(7.0, 3.6)
    axis = figure.subplots()
    axis.axhspan(*ARTICLE_DETECTION_PX, **ARTICLE_BAND, label="article's detection noise")
    lows, highs = zip(*implied_noise_px().values(), strict=True)
    axis.plot([-0.08, 0.92, 1.92], lows, marker="v", color=BLUE, linestyle="",
              label="implied by its least uncertainty, 0.5 m")  # fmt: skip
    axis.plot([0.08, 1.08, 2.08], highs, marker="^", color=ORANGE, linestyle="",
              label="implied by its greatest, 2.5 m")  # fmt: skip
    low, high = detection_noise_px(table)
    axis.plot([3, 3], [low, high], color=GREEN, linewidth=6, label="our detections")
    axis.set_xticks(range(4), ["x", "y", "z", "ours"])
    axis.set_xlim(-0.5, 3.5)
    axis.set_ylim(0.0, 0.065)
    axis.set_ylabel("detection noise (px)")
    legend_below(figure, 2)
    return figure
