"""Figures of the static experiment on the physical twin."""

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from vergence.eval.article.physical_static.error_budget import ALL, BUDGET_SOURCES, SOURCE_LABELS
from vergence.eval.article.physical_static.findings import (
    STILL_MM,
    article_results,
    population_ranks,
)
from vergence.eval.article.physical_static.trials import (
    ARTICLE_LARGEST_PERCENT,
    PhysicalStaticConfig,
)
from vergence.eval.article.twin.statistics import (
    AXES,
    METHOD_LABELS,
    METHODS,
    absolute_errors_mm,
    depth_errors_percent,
    fixation_rows,
)
from vergence.reporting.style import (
    ARTICLE_BAND,
    ARTICLE_STYLE,
    BLACK,
    BLUE,
    GREEN,
    GREY,
    METHOD_STYLE,
    ORANGE,
    PURPLE,
    legend_below,
    log_axis,
    new_figure,
)

SHORT: Final = {
    "link_m": "links",
    "coaxiality_rad": "coaxiality",
    "joint_offset_rad": "joint offsets",
    "head_eye_rad": "head-eye turn",
    "head_eye_m": "head-eye shift",
    "focal_relative": "focal length",
    "principal_px": "principal point",
    "common_tilt": "common tilt",
}
"""Short names of error sources, for legends on small screens."""
_MARKS: Final = (
    (BLUE, "o", "-"), (ORANGE, "s", "--"), (GREEN, "^", "-"), (PURPLE, "D", "--"),
    (BLACK, "v", "-"), (GREY, "P", ":"), (BLUE, "x", ":"), (ORANGE, "*", "-"),
    (GREEN, "<", ":"), (PURPLE, ">", "-"), (GREY, "h", "--"), (BLACK, "+", "--"),
)  # fmt: skip
_NEGLIGIBLE_PERCENT: Final = 0.002
"""Depth error below which a source is not drawn, percent of depth (chosen: readability)."""
DASHES: Final = {"gaze": "--", "itpc": ":"}
"""Line styles of the article's values by method."""


def draw(table: pd.DataFrame, config: PhysicalStaticConfig) -> dict[str, Figure]:
    """All figures by name."""
    del config
    return {
        "fig10-absolute-errors-physical": _errors(table),
        "fig10-population": _population(table),
        "fig11-uncertainties-physical": _uncertainties(table),
        "physical-error-budget": _budget(table),
        "physical-itpc-off-axis": _off_axis(table),
    }


def _errors(table: pd.DataFrame) -> Figure:
    figure = new_figure(9.6, 4.0)
    population, imaged = fixation_rows(table), fixation_rows(table, "imaged")
    depth, looked = (np.sort(rows["truth_z_mm"].unique()) / 1000.0 for rows in (population, imaged))
    for axis, panel in zip(AXES, figure.subplots(1, 3), strict=True):
        errors = absolute_errors_mm(population, "gaze", axis)
        low, median, high = np.percentile(errors, [10.0, 50.0, 90.0], axis=0)
        panel.fill_between(depth, low, high, color=BLUE, alpha=0.2, linewidth=0.0,
                           label="heads, 10-90 %")  # fmt: skip
        panel.plot(depth, median, color=BLUE, linewidth=1.2, label="median head")
        for method in METHODS:
            style = dict(METHOD_STYLE[method])
            style.update(label=f"{METHOD_LABELS[method]}, images", linewidth=1.3)
            if method == "itpc":
                style.update(markerfacecolor="none", markersize=9, linestyle="none")
            panel.plot(looked, absolute_errors_mm(imaged, method, axis)[0], **style)
        for r in article_results("absolute error"):
            if r.axis == axis:
                for value in (r.low, r.high):
                    panel.axhline(value, **{**ARTICLE_STYLE, "linestyle": DASHES[r.method]})
        for method, dash in DASHES.items():
            style = {**ARTICLE_STYLE, "linestyle": dash}
            panel.plot([], [], label=f"article, {METHOD_LABELS[method]}", **style)
        panel.set_xlabel("depth z [m]")
        panel.set_ylabel(f"|error in {axis}| [mm]")
        panel.set_ylim(bottom=0.0)
    legend_below(figure, 3)
    return figure


def _population(table: pd.DataFrame) -> Figure:
    figure = new_figure(9.0, 4.6)
    population = fixation_rows(table)
    left, right = figure.subplots(1, 2)
    largest = np.sort(depth_errors_percent(population, "gaze").max(axis=1))
    share = 100.0 * (np.arange(len(largest)) + 0.5) / len(largest)
    left.plot(largest, share, color=BLUE, drawstyle="steps-mid", label="gaze, settled")
    for method, percent in ARTICLE_LARGEST_PERCENT.items():
        left.axvline(percent, color=BLACK, linestyle=DASHES[method], linewidth=1.3,
                     label=f"article, {METHOD_LABELS[method]}: {percent} %")  # fmt: skip
    left.set_xlabel("largest depth error of a head [% of depth]")
    left.set_ylabel("heads below [%]")
    left.set_xlim(left=0.0)
    legend_below(left, 1)
    names, places = [], []
    for r in article_results("absolute error"):
        for which, placed in zip(("least", "most"), population_ranks(table, r), strict=True):
            names.append(f"{r.axis} {which}, {METHOD_LABELS[r.method]}")
            places.append(placed.percentile)
    row = np.arange(len(names))[::-1]
    right.axvspan(10.0, 90.0, **ARTICLE_BAND)
    right.plot(places, row, linestyle="none", marker="D", color=BLACK, markersize=7)
    right.set_yticks(row, names)
    right.set_xlim(0.0, 100.0)
    right.set_xlabel("article's head among ours [percentile]")
    right.set_title("shaded: middle 80 % of the heads", fontsize=11)
    return figure


def _uncertainties(table: pd.DataFrame) -> Figure:
    figure = new_figure(9.6, 3.9)
    imaged = fixation_rows(table, "imaged")
    for r, panel in zip(article_results("uncertainty"), figure.subplots(1, 3), strict=True):
        panel.axhspan(r.low, r.high, **ARTICLE_BAND)
        for method in METHODS:
            rows = imaged[imaged["method"] == method].sort_values("truth_z_mm")
            style = dict(METHOD_STYLE[method])
            if method == "itpc":
                style.update(markerfacecolor="none", markersize=9)
            panel.plot(rows["truth_z_mm"] / 1000.0, rows[f"uncertainty_{r.axis}_mm"], **style)
        rows = imaged[imaged["method"] == "gaze"].sort_values("truth_z_mm")
        moved = rows[rows[f"scatter_{r.axis}_mm"] > STILL_MM]
        panel.plot(moved["truth_z_mm"] / 1000.0, moved[f"scatter_{r.axis}_mm"], color=GREEN,
                   marker="^", linestyle="none",
                   label="gaze, observed scatter where an encoder stepped")  # fmt: skip
        panel.fill_between([], [], label="article's range", **ARTICLE_BAND)
        log_axis(panel)
        panel.set_xlabel("depth z [m]")
        panel.set_ylabel(f"uncertainty in {r.axis} [mm]")
    legend_below(figure, 2)
    return figure


def _budget(table: pd.DataFrame) -> Figure:
    figure = new_figure(8.0, 5.2)
    panel = figure.subplots()
    budget = table[table["case"] == "budget"]
    whole = budget[budget["source"] == ALL].sort_values("truth_z_mm")
    panel.plot(whole["truth_z_mm"] / 1000.0, whole["rms_depth_error_percent"], color=BLACK,
               linewidth=3.0, label="all, encoders too")  # fmt: skip
    order = (
        budget[(budget["source"] != ALL)]
        .groupby("source")["rms_depth_error_percent"].max().sort_values(ascending=False)
    )  # fmt: skip
    for source, (colour, marker, dash) in zip(
        order[order > _NEGLIGIBLE_PERCENT].index, _MARKS, strict=False
    ):
        rows = budget[budget["source"] == source].sort_values("truth_z_mm")
        panel.plot(rows["truth_z_mm"] / 1000.0, rows["rms_depth_error_percent"], color=colour,
                   marker=marker, linestyle=dash, linewidth=1.2, markevery=2,
                   label=SHORT.get(source, source))  # fmt: skip
    panel.axhline(ARTICLE_LARGEST_PERCENT["gaze"], label="article's largest, gaze", **ARTICLE_STYLE)
    zero = [SOURCE_LABELS.get(s, s) for s in order[order <= _NEGLIGIBLE_PERCENT].index]
    if zero:
        panel.set_title(f"nothing by: {', '.join(zero)}", fontsize=11)
    log_axis(panel)
    panel.set_xlabel("depth z [m]")
    panel.set_ylabel("rms depth error of a fixation [% of depth]")
    figure.legend(*panel.get_legend_handles_labels(), loc="outside right center")
    return figure


def _off_axis(table: pd.DataFrame) -> Figure:
    figure = new_figure(9.6, 5.0)
    left, right = figure.subplots(1, 2)
    rows = table[table["case"] == "off axis"]
    whole = rows[rows["source"] == ALL].sort_values("offset_px")
    style = {m: {**METHOD_STYLE[m]} for m in METHODS}
    style["gaze"]["label"], style["itpc"]["label"] = "gaze, settled: rms", "ITPC: rms"
    for method in METHODS:
        left.plot(whole["offset_px"], whole[f"{method}_rms_percent"], **style[method])
    left.plot(whole["offset_px"], whole["added_rms_percent"], color=GREEN, marker="^",
              linestyle="-.", label="difference: rms")  # fmt: skip
    left.plot(whole["offset_px"], whole["itpc_largest_percent"], color=PURPLE, marker="D",
              linestyle="-", label="ITPC: median head's largest")  # fmt: skip
    left.axhline(ARTICLE_LARGEST_PERCENT["itpc"], label="article's largest, ITPC", **ARTICLE_STYLE)
    left.set_ylim(bottom=0.0)
    left.set_title("all errors")
    left.set_ylabel("depth error [% of depth]")
    legend_below(left, 1)
    for source, (colour, marker, dash) in zip(BUDGET_SOURCES, _MARKS, strict=False):
        own = rows[rows["source"] == source].sort_values("offset_px")
        change = own["itpc_rms_percent"] - own["gaze_rms_percent"]
        right.plot(own["offset_px"], change, color=colour, marker=marker, linestyle=dash,
                   linewidth=1.3, label=SHORT.get(source, source))  # fmt: skip
    right.axhline(0.0, color=BLACK, linewidth=1.0)
    right.set_title("one source alone")
    right.set_ylabel("rms of ITPC less that of gaze [points]")
    legend_below(right, 2, columnspacing=1.0)
    for panel in (left, right):
        panel.set_xlabel("target off the axis [px]")
    return figure
