"""The figures of the uncertainties."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from vergence.eval.article.common.loop_noise import LinearLoop, noise_gain
from vergence.eval.article.simulated_moving.findings import article_value_mm as reported_moving
from vergence.eval.article.simulated_static.findings import ARTICLE_DETECTION_PX, article_result
from vergence.eval.article.uncertainty.findings import (
    METHOD_NAMES,
    averaged_errors_px,
    cramer_rao_bounds_px,
    noise_gains,
    rows_of_part,
)
from vergence.eval.article.uncertainty.trials import AHEAD, UncertaintyConfig
from vergence.models.head_file import load_head
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


def draw(table: pd.DataFrame, config: UncertaintyConfig) -> dict[str, Figure]:
    """The figures by name."""
    return {
        "uncertainty-propagated": _propagated(table),
        "uncertainty-noise-bandwidth": _loop(table, config),
        "uncertainty-averaging": _averaging(table),
    }


def _propagated(table: pd.DataFrame) -> Figure:
    figure = new_figure(9.5, 4.6)
    axes = figure.subplots(1, 3)
    rows = rows_of_part(table, "propagation")
    rows = rows[(rows["unit"] == "mm") & (rows["pose"] == AHEAD)]
    for axis, letter in zip(axes, "xyz", strict=True):
        own = rows[rows["axis"] == letter].sort_values("depth_mm")
        article = article_result("uncertainty", letter)
        axis.axhspan(article.low, article.high, **ARTICLE_BAND, label="article's range")
        for method in ("gaze", "itpc"):
            style = METHOD_STYLE[method]
            for quantity in ("propagated", "Monte Carlo"):
                values = own[(own["method"] == method) & (own["quantity"] == quantity)]
                line = quantity == "propagated"
                axis.plot(
                    values["depth_mm"] / 1000.0, values["value"], color=style["color"],
                    linestyle=style["linestyle"] if line else "none",
                    marker="" if line else style["marker"], markerfacecolor="none",
                    label=METHOD_NAMES[method] if line else f"{style['label']}, Monte Carlo",
                )  # fmt: skip
        axis.set_title(letter)
        axis.set_xlabel("depth (m)")
        log_axis(axis)
    axes[0].set_ylabel("uncertainty, standard deviation (mm)")
    legend_below(figure, 3)
    return figure


def _loop(table: pd.DataFrame, config: UncertaintyConfig) -> Figure:
    figure = new_figure(7.0, 4.2)
    axis = figure.subplots()
    measured = noise_gains(table, config)
    head = load_head("simulated")
    gains = np.linspace(0.1, max(4.5, float(measured["gain_per_s"].max())), 60)
    axis.plot(gains, [noise_gain(LinearLoop.of(head, float(gain))) for gain in gains], color=BLACK,
              label="from the noise bandwidth")  # fmt: skip
    for source, colour, marker in (("white noise", BLUE, "x"), ("images", ORANGE, "o")):
        own = measured[measured["source"] == source]
        axis.plot(own["gain_per_s"], own["measured"], color=colour, marker=marker, linestyle="",
                  markersize=8, markeredgewidth=2, label=f"measured, {source}")  # fmt: skip
    ratio = reported_moving("standard deviation", "gaze", "z") / reported_moving(
        "standard deviation", "itpc", "z"
    )
    axis.axhline(ratio, **ARTICLE_STYLE, label="article, moving target: 0.30 / 0.98 mm")
    axis.set_xlabel("gain k (1/s)")
    axis.set_ylabel("scatter of the axes\nover that of detections")
    axis.set_ylim(0.0, None)
    legend_below(figure, 2)
    return figure


def _averaging(table: pd.DataFrame) -> Figure:
    errors, bound = averaged_errors_px(table), cramer_rao_bounds_px(table)
    depths = list(bound.index)
    figure = new_figure(9.5 if len(depths) > 1 else 6.0, 4.8)
    axes = figure.subplots(1, len(depths), sharey=True, squeeze=False)[0]
    for axis, depth in zip(axes, depths, strict=True):
        frames = np.asarray(errors.columns, dtype=np.float64)
        axis.axhspan(*ARTICLE_DETECTION_PX, **ARTICLE_BAND, label="article's detection noise")
        for fixation, colour, marker, dash in (
            ("still", BLUE, "o", "-"),
            ("dithered", GREEN, "^", "--"),
        ):
            axis.plot(frames, errors.loc[(depth, fixation)], color=colour, marker=marker,
                      linestyle=dash, label=f"{fixation} fixation")  # fmt: skip
        for name, colour, dash in (("window", PURPLE, "-."), ("board", GREY, "-")):
            axis.plot(frames, bound.loc[depth, name] / np.sqrt(frames), color=colour,
                      linestyle=dash, label=f"Cramér-Rao bound, {name}")  # fmt: skip
        axis.set_title(f"{depth / 1000.0:g} m")
        axis.set_xlabel("frames averaged")
        log_axis(axis, "x")
        log_axis(axis)
    axes[0].set_ylabel("root mean square error (px)")
    legend_below(figure, 3)
    return figure
