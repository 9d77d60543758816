"""The figures of the moving target on the simulated rig."""

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from vergence.eval.article.common.loop_noise import LinearLoop, noise_gain
from vergence.eval.article.common.simulated_cases import CASES
from vergence.eval.article.simulated_moving.findings import (
    ARTICLE_CASE,
    RATES_HZ,
    article_deviation_ratio,
    article_value_mm,
    deviation_ratio,
    errors_by_case,
    select_samples,
)
from vergence.eval.article.simulated_moving.trials import IMAGES, WHITE, SimulatedMovingConfig
from vergence.models.head_file import load_head
from vergence.reporting.style import (
    ARTICLE_STYLE,
    BLUE,
    GREEN,
    GREY,
    METHOD_STYLE,
    ORANGE,
    PURPLE,
    figure_style,
    legend_below,
    log_axis,
    new_figure,
)

_DRAWN_EVERY: Final = 6
"""Step through the samples that are drawn (chosen: readability)."""


def draw(table: pd.DataFrame, config: SimulatedMovingConfig) -> dict[str, Figure]:
    """The figures by name."""
    with figure_style():
        return {
            "fig08-moving-target": _errors(table),
            "fig08-mean-absolute-errors": _bars(table),
            "fig08-noise-bandwidth": _ratios(table, config),
        }


def _errors(table: pd.DataFrame) -> Figure:
    figure = new_figure(9.5, 5.6)
    axes = figure.subplots(2, 3, sharex=True, sharey="col")
    for row, case in zip(axes, ("exact", ARTICLE_CASE), strict=True):
        for axis, letter in zip(row, "xyz", strict=True):
            for method in ("itpc", "gaze"):
                samples = select_samples(table, case, method).iloc[::_DRAWN_EVERY]
                style = METHOD_STYLE[method]
                axis.plot(
                    samples["time_s"], samples[f"error_{letter}_mm"], color=style["color"],
                    linestyle="-" if method == "gaze" else "none",
                    marker="" if method == "gaze" else ".", markersize=2.5,
                    label=style["label"],
                )  # fmt: skip
            article = article_value_mm("mean absolute error", "gaze", letter)
            for sign in (-1.0, 1.0):
                axis.axhline(sign * article, **ARTICLE_STYLE,
                             label="article: ± mean absolute error, gaze")  # fmt: skip
            axis.set_title(f"{letter}, {CASES[case].title}", fontsize=10)
        row[0].set_ylabel("error (mm)")
    for axis in axes[-1]:
        axis.set_xlabel("time (s)")
    legend_below(figure, 3, markerscale=3)
    return figure


def _bars(table: pd.DataFrame) -> Figure:
    errors = errors_by_case(table)
    figure = new_figure(9.5, 4.2)
    axes = figure.subplots(1, 3, sharey=True)
    methods = ("gaze", "itpc")
    for axis, letter in zip(axes, "xyz", strict=True):
        for number, (case, colour, hatch) in enumerate(
            zip(CASES, (GREEN, BLUE, ORANGE, PURPLE), ("", "//", "..", "xx"), strict=False)
        ):
            values = [errors[case, method, IMAGES].mean_absolute[letter] for method in methods]
            axis.bar(
                np.arange(2) + 0.25 * (number - 0.5 * (len(CASES) - 1)), values, 0.23,
                color=colour, hatch=hatch, edgecolor="white", label=CASES[case].title,
            )  # fmt: skip
        for place, method in enumerate(methods):
            axis.plot(
                [place - 0.42, place + 0.42],
                2 * [article_value_mm("mean absolute error", method, letter)],
                **{**ARTICLE_STYLE, "linewidth": 2.2}, label="article",
            )  # fmt: skip
        axis.set_xticks(range(2), ["gaze", "ITPC"])
        axis.set_title(letter)
        axis.set_axisbelow(True)
        log_axis(axis)
    axes[0].set_ylabel("mean absolute error (mm)")
    legend_below(figure, 2)
    return figure


def _ratios(table: pd.DataFrame, config: SimulatedMovingConfig) -> Figure:
    errors = errors_by_case(table)
    figure = new_figure(7.0, 4.0)
    axis = figure.subplots()
    gains = np.linspace(0.25, 4.5, 40)
    head = load_head("simulated")
    for rate, colour, dash in zip(
        RATES_HZ[:3], (BLUE, PURPLE, GREEN), ("-", "--", "-."), strict=True
    ):
        values = [noise_gain(LinearLoop.of(head, float(gain)).at_rate(rate)) for gain in gains]
        axis.plot(gains, values, color=colour, linestyle=dash, label=f"predicted at {rate:g} Hz")
    images, white = (deviation_ratio(errors, "exact", noise) for noise in (IMAGES, WHITE))
    axis.plot(config.gain, images, marker="o", markersize=9, color=ORANGE,
              linestyle="", label="measured, images, exact model")  # fmt: skip
    axis.plot(config.gain, white, marker="x", markersize=9, color=GREY,
              markeredgewidth=2, linestyle="", label="measured, white noise")  # fmt: skip
    axis.axhline(article_deviation_ratio(), **ARTICLE_STYLE, label="article: 0.30 / 0.98 mm")
    axis.set_xlabel("gain k (1/s)")
    axis.set_ylabel("standard deviation in z,\ngaze over ITPC")
    axis.set_ylim(0.0, None)
    legend_below(figure, 2)
    return figure
