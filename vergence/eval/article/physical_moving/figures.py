"""Figures of the moving experiment on the physical twin."""

from typing import Final

import pandas as pd
from matplotlib.figure import Figure

from vergence.eval.article.physical_moving.findings import (
    article_result,
    column_by_head,
    population_rank,
)
from vergence.eval.article.physical_moving.trials import PhysicalMovingConfig
from vergence.eval.article.twin.statistics import AXES, METHOD_LABELS, METHODS
from vergence.reporting.style import (
    ARTICLE_STYLE,
    BLACK,
    BLUE,
    GREY,
    METHOD_STYLE,
    ORANGE,
    legend_below,
    new_figure,
)

_COLOUR: Final = {"gaze": BLUE, "itpc": ORANGE}


def draw(table: pd.DataFrame, config: PhysicalMovingConfig) -> dict[str, Figure]:
    """All figures by name."""
    del config
    return {
        "fig12-trajectory": _trajectory(table),
        "fig13-absolute-errors-physical": _errors(table),
        "fig13-population": _population(table),
    }


def _trajectory(table: pd.DataFrame) -> Figure:
    figure = new_figure(9.0, 4.2)
    rows = table[table["case"] == "time"]
    for panel, axis in zip(figure.subplots(1, 2), ("x", "y"), strict=True):
        truth = rows[rows["method"] == "gaze"]
        panel.plot(truth["truth_z_mm"], truth[f"truth_{axis}_mm"], color=BLACK, linewidth=2.5,
                   label="truth")  # fmt: skip
        for method in METHODS:
            own = rows[rows["method"] == method]
            style = {**METHOD_STYLE[method], "linestyle": "none", "markersize": 5}
            style["label"] = f"{METHOD_LABELS[method]}, images"
            if method == "itpc":
                style.update(markerfacecolor="none", markersize=8)
            panel.plot(
                own["truth_z_mm"] + own["error_z_mm"],
                own[f"truth_{axis}_mm"] + own[f"error_{axis}_mm"],
                **style,
            )
        panel.set_xlabel("z [mm]")
        panel.set_ylabel(f"{axis} [mm]")
    legend_below(figure, 3)
    return figure


def _errors(table: pd.DataFrame) -> Figure:
    figure = new_figure(9.6, 4.2)
    rows, bands = table[table["case"] == "time"], table[table["case"] == "band"]
    for panel, axis in zip(figure.subplots(1, 3), AXES, strict=True):
        band = bands[(bands["axis"] == axis) & (bands["method"] == "gaze")]
        panel.fill_between(band["time_s"], band["low_mm"], band["high_mm"], color=GREY, alpha=0.25,
                           linewidth=0.0, label="heads by gaze, 10-90 %")  # fmt: skip
        panel.plot(band["time_s"], band["median_mm"], color=GREY, linewidth=1.2,
                   label="median head")  # fmt: skip
        for method, dash in zip(METHODS, ("--", ":"), strict=True):
            own = rows[rows["method"] == method]
            panel.plot(own["time_s"], own[f"error_{axis}_mm"].abs(), color=_COLOUR[method],
                       linestyle=METHOD_STYLE[method]["linestyle"],
                       label=f"{METHOD_LABELS[method]}, images")  # fmt: skip
            panel.axhline(article_result(method, axis).low,
                          label=f"article, {METHOD_LABELS[method]}",
                          **{**ARTICLE_STYLE, "linestyle": dash})  # fmt: skip
        panel.set_xlabel("time [s]")
        panel.set_ylabel(f"|error in {axis}| [mm]")
        panel.set_ylim(bottom=0.0)
    legend_below(figure, 3)
    return figure


def _population(table: pd.DataFrame) -> Figure:
    figure = new_figure(8.0, 4.2)
    panel = figure.subplots()
    for k, (axis, method) in enumerate((a, m) for a in AXES for m in METHODS):
        placed = population_rank(table, method, axis)
        own = column_by_head(table, "population", method, f"mean_abs_{axis}_mm")
        panel.plot(own, [k] * len(own), linestyle="none", marker="|", markersize=9,
                   color=_COLOUR[method], alpha=0.5,
                   label="a head" if k == 0 else None)  # fmt: skip
        panel.plot([placed.low, placed.high], [k, k], color=_COLOUR[method], linewidth=7,
                   alpha=0.35, solid_capstyle="butt",
                   label="heads, 10-90 %" if k == 0 else None)  # fmt: skip
        panel.plot(placed.article, k, linestyle="none", marker="D", color=BLACK, markersize=8,
                   label="article" if k == 0 else None)  # fmt: skip
    panel.set_yticks(range(6), [f"{a}, {METHOD_LABELS[m]}" for a in AXES for m in METHODS])
    panel.invert_yaxis()
    panel.set_xlim(left=0.0)
    panel.set_xlabel("mean absolute error of a head along the line [mm]")
    legend_below(figure, 3)
    return figure
