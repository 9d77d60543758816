"""Figures of the comparison with a fixed pair."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from vergence.eval.article.fixed_pair.findings import differences, errors, reported
from vergence.eval.article.twin.statistics import AXES
from vergence.eval.reporting.style import ARTICLE_BAND, BLUE, GREEN, ORANGE, new_figure, styled


def draw(table: pd.DataFrame, config: Any) -> dict[str, Figure]:
    """All figures by name."""
    del config
    with styled():
        return {"fig14-differences": _differences(table), "fig14-truth": _truth(table)}


def _whiskers(panel: Any, values: np.ndarray, shift: float, **style: Any) -> None:
    """Median and middle 80 % of the draws at each point."""
    low, median, high = np.percentile(np.abs(values), [10.0, 50.0, 90.0], axis=0)
    panel.errorbar(
        np.arange(1, values.shape[1] + 1) + shift, median, yerr=[median - low, high - median],
        linestyle="none", capsize=3, markersize=6, elinewidth=1.3, **style,
    )  # fmt: skip


def _differences(table: pd.DataFrame) -> Figure:
    figure = new_figure(9.6, 4.2)
    for axis, panel in zip(AXES, figure.subplots(1, 3), strict=True):
        row = next(r for r in reported() if r.axis == axis)
        assert row.high is not None
        panel.axhspan(row.low, row.high, **ARTICLE_BAND, label="article's range")
        for pair, shift, style in (
            ("pair", -0.15, {"color": BLUE, "marker": "o", "label": "pose known"}),
            ("misaligned", 0.15, {"color": ORANGE, "marker": "s", "label": "pose unknown"}),
        ):
            _whiskers(panel, differences(table, "gaze", axis, pair), shift, **style)
        panel.set_xlabel("point of Table 7")
        panel.set_ylabel(f"|gaze - pair| in {axis} [mm]")
        panel.set_xticks(range(1, 9))
        panel.set_ylim(bottom=0.0)
    figure.legend(*panel.get_legend_handles_labels(), loc="outside lower center", ncols=3,
                  title="median and middle 80 % of 100 draws".replace(
                      "100", str(len(errors(table, "pair", "z")))))  # fmt: skip
    return figure


def _truth(table: pd.DataFrame) -> Figure:
    figure = new_figure(9.6, 4.2)
    for axis, panel in zip(AXES, figure.subplots(1, 3), strict=True):
        for method, shift, style in (
            ("gaze", -0.22, {"color": BLUE, "marker": "o", "label": "gaze"}),
            ("itpc", 0.0, {"color": ORANGE, "marker": "s", "label": "ITPC"}),
            ("pair", 0.22, {"color": GREEN, "marker": "^", "label": "fixed pair"}),
        ):
            _whiskers(panel, errors(table, method, axis), shift, **style)
        panel.set_xlabel("point of Table 7")
        panel.set_ylabel(f"|error in {axis}| [mm]")
        panel.set_xticks(range(1, 9))
        panel.set_ylim(bottom=0.0)
    figure.legend(*panel.get_legend_handles_labels(), loc="outside lower center", ncols=3,
                  title="against the truth, which the article did not have")  # fmt: skip
    return figure
