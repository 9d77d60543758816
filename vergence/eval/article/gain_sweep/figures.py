"""The figures of the gain sweep."""

from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from vergence.eval.article.gain_sweep.findings import (
    ARTICLE_GAIN,
    GainSweepFindings,
    derive_findings,
    sweep_trials,
)
from vergence.eval.article.gain_sweep.loop_delay import critical_lag
from vergence.eval.article.gain_sweep.trials import PLANE_STEPS, GainSweepConfig
from vergence.reporting.style import (
    ARTICLE_STYLE,
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    figure_style,
    legend_below,
    log_axis,
    new_figure,
)

_STEP_STYLE: Final[dict[str, dict[str, Any]]] = {
    "+y": {"color": BLUE, "linestyle": "-", "linewidth": 3.2, "alpha": 0.55},
    "-y": {"color": BLACK, "linestyle": "--"},
    "+x": {"color": ORANGE, "linestyle": ":"},
}
"""Line styles: both directions of the article's axis, and one along x, on which k1 acts."""


def draw(table: pd.DataFrame, config: GainSweepConfig) -> dict[str, Figure]:
    """All figures by name."""
    found = derive_findings(table, config)
    return {
        "fig15-gain-sweep": _draw_sweep(table, config),
        "fig15-gain-plane": _draw_plane(table),
        "fig15-loop-delay": _draw_loops(found, config),
    }


def _draw_sweep(table: pd.DataFrame, config: GainSweepConfig) -> Figure:
    with figure_style():
        figure = new_figure(9.0, 4.3)
        left, right = figure.subplots(1, 2)
        for step, style in _STEP_STYLE.items():
            rows = sweep_trials(table, step)
            left.plot(rows["k1_per_s"], rows["settle_1px_s"], label=f"step along {step}", **style)
            right.plot(rows["k1_per_s"], 100.0 * rows["overshoot"], **style)
        rows = sweep_trials(table, "-y")
        ideal = np.log(rows["step_px"]) / rows["k1_per_s"]
        left.plot(rows["k1_per_s"], ideal, color=GREY, linewidth=1.2, label="ln(step / 1 px) / k")
        for axes, column, scale in ((left, "settle_1px_s", 1.0), (right, "overshoot", 100.0)):
            dots = sweep_trials(table, "-y", "mujoco")
            axes.plot(
                dots["k1_per_s"], scale * dots[column], "o", color=BLACK, mfc="white",
                label="with masses, -y",
            )  # fmt: skip
            axes.axvline(ARTICLE_GAIN, **ARTICLE_STYLE)
            axes.set(xlabel="gain $k_1 = k_2$ (1/s)", xlim=(0.0, config.greatest_gain + 0.2))
        left.set(ylabel="settle time to 1 px (s)", title="Settle time")
        log_axis(left)
        level = 100.0 * config.onset_fraction
        right.set(ylabel="overshoot (% of the step)", title="Overshoot")
        right.set_yscale("symlog", linthresh=0.1)
        right.set_ylim(-0.02, 20.0)
        right.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        right.axhline(level, color=GREY, linewidth=1.0)
        right.annotate(
            f"counts as begun: {level:g} %", (0.1, level), (2, 4), textcoords="offset points"
        )
        right.annotate(
            "article:\novershoot above 4", (ARTICLE_GAIN, 0.9), (-6, 0),
            xycoords=("data", "axes fraction"), textcoords="offset points", ha="right", va="top",
        )  # fmt: skip
        legend_below(figure, 5, fontsize=10)
    return figure


def _draw_plane(table: pd.DataFrame) -> Figure:
    titles = {"+y": "Step in y alone", "+x+y": "Step in x and y"}
    plane = table[table["case"] == "plane"]
    low, high = plane["settle_1px_s"].min(), plane["settle_1px_s"].max()
    norm = LogNorm(low, high)
    with figure_style():
        figure = new_figure(9.0, 4.3)
        panels = figure.subplots(1, 2, sharex=True, sharey=True)
        for axes, step in zip(panels, PLANE_STEPS, strict=True):
            rows = plane[plane["step"] == step]
            grid = rows.pivot_table(index="k2_per_s", columns="k1_per_s", values="settle_1px_s")
            filled = axes.pcolormesh(
                grid.columns, grid.index, grid.to_numpy(), norm=norm, cmap="cividis",
                shading="nearest", rasterized=True,
            )  # fmt: skip
            lines = axes.contour(
                grid.columns, grid.index, grid.to_numpy(), levels=[0.8, 1.2, 2.0, 4.0],
                colors="white", linewidths=1.0,
            )  # fmt: skip
            axes.clabel(lines, fmt="%g s", fontsize=10)
            for mark in (axes.axvline, axes.axhline):
                mark(ARTICLE_GAIN, **{**ARTICLE_STYLE, "color": "white"})
            axes.set(title=titles[step], xlabel="$k_1$ (1/s)", aspect="equal")
            axes.grid(visible=False)
        panels[0].set_ylabel("$k_2$ (1/s)")
        bar = figure.colorbar(filled, ax=list(panels), label="settle time to 1 px (s)", pad=0.02)
        ticks = [tick for tick in (0.5, 1.0, 2.0, 4.0, 8.0) if low <= tick <= high]
        bar.minorticks_off()
        bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    return figure


def _draw_loops(found: GainSweepFindings, config: GainSweepConfig) -> Figure:
    with figure_style():
        figure = new_figure(6.4, 4.6)
        axes = figure.subplots()
        _draw_families(axes, found, config)
        axes.plot(
            found.latency_frames, 1000.0 * found.lag_s, "D", color=BLACK, markersize=9,
            label=f"our rig: {found.latency_frames} frames, {1000.0 * found.lag_s:g} ms",
        )  # fmt: skip
        hold = 0.5 * found.period_s
        delays = np.linspace(0.0, 14.0, 113) * found.period_s
        lags = [critical_lag(delay + hold, ARTICLE_GAIN) for delay in delays]
        axes.plot(
            delays / found.period_s, 1000.0 * np.array(lags), **ARTICLE_STYLE,
            label=f"linear theory: none at all up to k = {ARTICLE_GAIN:g}",
        )  # fmt: skip
        axes.set(
            xlabel=f"image delay (frames of {1000.0 * found.period_s:.3g} ms)",
            ylabel="lag of the joints (ms)",
            title="Loops whose overshoot begins where the article's does",
            xlim=(-0.2, None), ylim=(0.0, None),
        )  # fmt: skip
        legend_below(figure, 2, fontsize=10)
    return figure


def _draw_families(axes: Axes, found: GainSweepFindings, config: GainSweepConfig) -> None:
    level = 100.0 * config.onset_fraction
    for family, color, style in zip(found.families, (BLUE, GREEN), ("-", "--"), strict=True):
        delays = np.append(family.delays_frames, family.longest_delay_frames)
        lags = np.append(family.lags_s, 0.0)
        known = np.isfinite(delays) & np.isfinite(lags)
        axes.plot(
            delays[known], 1000.0 * lags[known], color=color, linestyle=style,
            label=f"{level:g} % at k = {family.gain:g}",
        )  # fmt: skip
