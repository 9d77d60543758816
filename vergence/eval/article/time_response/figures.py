"""The figures of the time response."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure

from vergence.eval.article.time_response.findings import (
    TimeResponseFindings,
    derive_findings,
    held_thresholds_px,
    settle_time_map,
)
from vergence.eval.article.time_response.trials import ARTICLE_S, TimeResponseConfig
from vergence.reporting.style import (
    ARTICLE_STYLE,
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    figure_style,
    legend_below,
    log_axis,
    new_figure,
)


def draw(table: pd.DataFrame, config: TimeResponseConfig) -> dict[str, Figure]:
    """All figures by name."""
    found = derive_findings(table)
    return {
        "time-response-error": _draw_trace(table, found),
        "time-response-map": _draw_map(table, config, found),
    }


def _draw_trace(table: pd.DataFrame, found: TimeResponseFindings) -> Figure:
    trace = table[table["case"] == "trace"]
    styles: dict[str, dict[str, Any]] = {
        "left": {"color": BLUE},
        "right": {"color": ORANGE, "linestyle": "--"},
    }
    with figure_style():
        figure = new_figure(6.4, 4.4)
        axes = figure.subplots()
        for eye, style in styles.items():
            rows = trace[trace["eye"] == eye]
            axes.plot(1000.0 * rows["time_s"], rows["error_px"], label=f"{eye} eye", **style)
        ends = 0.0
        for band, (_, latest) in found.settle_s.items():
            axes.axhline(band, color=GREY, linewidth=1.0)
            if np.isfinite(latest):
                ends = max(ends, latest)
                axes.plot(1000.0 * latest, band, "o", color=BLACK, mfc="white")
                axes.annotate(
                    f"{band:g} px: {1000.0 * latest:.0f} ms", (1000.0 * latest, band),
                    (-6, -5), textcoords="offset points", ha="right", va="top",
                )  # fmt: skip
        axes.axvline(1000.0 * ARTICLE_S, **ARTICLE_STYLE)
        axes.annotate(
            f"article:\n{1000.0 * ARTICLE_S:.0f} ms", (1000.0 * ARTICLE_S, 0.95), (6, 0),
            xycoords=("data", "axes fraction"), textcoords="offset points", va="top",
        )  # fmt: skip
        axes.set(
            xlabel="time since the target appeared (ms)", ylabel="true pixel error (px)",
            title=f"Our rig: {found.delay_frames} frames, {1000.0 * found.lag_s:g} ms",
            xlim=(0.0, 1000.0 * max(0.9, 1.2 * ends)), ylim=(0.02, 80.0),
        )  # fmt: skip
        log_axis(axes)
        legend_below(figure, 2)
    return figure


def _draw_map(
    table: pd.DataFrame, config: TimeResponseConfig, found: TimeResponseFindings
) -> Figure:
    lags = list(dict.fromkeys((found.lag_s, 0.0)))
    edges = np.arange(0.35, 1.26, 0.1)
    with figure_style():
        figure = new_figure(9.0, 4.6)
        panels = figure.subplots(1, len(lags), sharex=True, sharey=True, squeeze=False)[0]
        for axes, lag_s in zip(panels, lags, strict=True):
            grid = settle_time_map(table, lag_s)
            filled = axes.pcolormesh(
                grid.columns, grid.index, grid.to_numpy(), shading="nearest", cmap="cividis",
                norm=BoundaryNorm(edges, 256, extend="both"), rasterized=True,
            )  # fmt: skip
            by = held_thresholds_px(table, lag_s)
            axes.plot(
                by["delay_frames"], by["threshold_px"], color="white", linewidth=2.4,
                label=f"settled by {1000.0 * ARTICLE_S:.0f} ms above",
            )  # fmt: skip
            _mark(axes, found, lag_s)
            name = f"lag {1000.0 * lag_s:g} ms" if lag_s else "no lag"
            axes.set(title=name, xlabel="image delay (frames)")
            axes.set_ylim(config.least_threshold_px, config.greatest_threshold_px)
            axes.grid(visible=False)
            dark = {"frameon": True, "facecolor": "#555555", "labelcolor": "white"}
            legend_below(axes, 1, fontsize=10, **dark)
        panels[0].set_ylabel("settle threshold (px)")
        bar = figure.colorbar(filled, ax=list(panels), label="settle time (s)", pad=0.02)
        bar.ax.axhline(ARTICLE_S, color="white", linewidth=2.4)
    return figure


def _mark(axes: Axes, found: TimeResponseFindings, lag_s: float) -> None:
    """Mark the pairs of delay and threshold that should give the article's time, and our rig."""
    for pair in found.pairs:
        if pair.lag_s == lag_s and np.isfinite(pair.settle_s):
            axes.plot(
                pair.delay_frames, pair.threshold_px, "^", color="white", mec="black",
                markersize=10, clip_on=False, zorder=5, linestyle="none",
                label=f"{pair.delay_frames} frames, {pair.threshold_px:g} px: "
                f"{1000.0 * pair.settle_s:.0f} ms",
            )  # fmt: skip
    if lag_s == found.lag_s:
        _, latest = found.settle_s[1.0]
        axes.plot(
            found.delay_frames, 1.0, "D", color="white", mec="black", markersize=9, zorder=5,
            linestyle="none", label=f"our rig, 1 px: {1000.0 * latest:.0f} ms",
        )  # fmt: skip
