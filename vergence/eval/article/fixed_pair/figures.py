"""Figures of the comparison with a fixed pair."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vergence.eval.article.fixed_pair.findings import (
    absolute_differences_mm,
    article_results,
    fix_errors_mm,
)
from vergence.eval.article.fixed_pair.trials import FixedPairConfig
from vergence.eval.article.twin.statistics import AXES
from vergence.models.parts import FloatArray
from vergence.reporting.style import (
    ARTICLE_BAND,
    BLUE,
    GREEN,
    ORANGE,
    legend_below,
    new_figure,
)

_PAIRS: Final[dict[str, dict[str, Any]]] = {
    "pair": {"color": BLUE, "marker": "o", "label": "pose known"},
    "misaligned": {"color": ORANGE, "marker": "s", "label": "pose unknown"},
}
_METHODS: Final[dict[str, dict[str, Any]]] = {
    "gaze": {"color": BLUE, "marker": "o", "label": "gaze"},
    "itpc": {"color": ORANGE, "marker": "s", "label": "ITPC"},
    "pair": {"color": GREEN, "marker": "^", "label": "fixed pair"},
}


def draw(table: pd.DataFrame, config: FixedPairConfig) -> dict[str, Figure]:
    """All figures by name."""
    del config
    return {"fig14-differences": _differences(table), "fig14-truth": _truth(table)}


def _differences(table: pd.DataFrame) -> Figure:
    def draw_panel(panel: Axes, axis: str) -> None:
        row = next(r for r in article_results() if r.axis == axis)
        panel.axhspan(*row.span, **ARTICLE_BAND, label="article's range")
        for shift, (pair, style) in zip((-0.15, 0.15), _PAIRS.items(), strict=True):
            _whiskers(panel, absolute_differences_mm(table, "gaze", axis, pair), shift, **style)
        panel.set_ylabel(f"|gaze - pair| in {axis} [mm]")

    draws = len(fix_errors_mm(table, "pair", "z"))
    return _by_axis(draw_panel, f"median and middle 80 % of {draws} draws")


def _truth(table: pd.DataFrame) -> Figure:
    def draw_panel(panel: Axes, axis: str) -> None:
        for shift, (method, style) in zip((-0.22, 0.0, 0.22), _METHODS.items(), strict=True):
            _whiskers(panel, fix_errors_mm(table, method, axis), shift, **style)
        panel.set_ylabel(f"|error in {axis}| [mm]")

    return _by_axis(draw_panel, "against the truth, which the article did not have")


def _by_axis(draw_panel: Callable[[Axes, str], None], title: str) -> Figure:
    """A figure with a panel per axis, over the points of Table 7."""
    figure = new_figure(9.6, 4.2)
    for axis, panel in zip(AXES, figure.subplots(1, 3), strict=True):
        draw_panel(panel, axis)
        panel.set_xlabel("point of Table 7")
        panel.set_xticks(range(1, 9))
        panel.set_ylim(bottom=0.0)
    legend_below(figure, 3, title=title)
    return figure


def _whiskers(panel: Axes, values: FloatArray, shift: float, **style: Any) -> None:
    """Median and middle 80 % of the draws at each point."""
    low, median, high = np.percentile(np.abs(values), [10.0, 50.0, 90.0], axis=0)
    panel.errorbar(
        np.arange(1, values.shape[1] + 1) + shift, median, yerr=[median - low, high - median],
        linestyle="none", capsize=3, markersize=6, elinewidth=1.3, **style,
    )  # fmt: skip
