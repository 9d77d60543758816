"""The figures of an evaluation, a set for each scenario and plant; a style for each controller."""

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vergence.eval.comparison.contestants import BASELINE, BOUND
from vergence.eval.comparison.evaluate import Evaluation, EvaluationResult
from vergence.eval.comparison.statistics import bound_trials, imputed_trial_values, median
from vergence.eval.comparison.tables import has_residual
from vergence.eval.trials.settling import SettlingBand
from vergence.models.parts import FloatArray
from vergence.reporting.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    figure_style,
    label_lines,
    legend_below,
    log_axis,
    new_figure,
)

Values = FloatArray | pd.Series
"""(n,) values of a line or a column of a table."""

_REGISTRY_STYLES: Final[dict[str, dict[str, Any]]] = {
    BOUND: {"color": BLACK, "linestyle": (0, (1, 1)), "marker": "|"},
    BASELINE: {"color": BLACK, "linestyle": "-", "marker": "o"},
    "ibvs": {"color": GREY, "linestyle": "-", "marker": "v"},
    "adaptive": {"color": "#9a6a00", "linestyle": "--", "marker": "D"},
    "pid": {"color": "#c2458b", "linestyle": "-.", "marker": "^"},
    "fuzzy": {"color": PURPLE, "linestyle": (0, (6, 2)), "marker": "P"},
    "delay-compensated": {"color": BLUE, "linestyle": "--", "marker": "s"},
    "state-feedback": {"color": "#6b4c35", "linestyle": (0, (4, 1, 1, 1)), "marker": "p"},
    "saccade": {"color": ORANGE, "linestyle": "-", "marker": "*"},
    "pursuit": {"color": GREEN, "linestyle": "-.", "marker": "X"},
    "learned-gain": {"color": "#2bb3b0", "linestyle": (0, (3, 1, 1, 1)), "marker": "<"},
    "learned-policy": {"color": "#b0122e", "linestyle": (0, (8, 2, 2, 2)), "marker": ">"},
}
# colours, dashes (in line widths) and markers of controllers outside the registry (chosen)
_COLORS: Final = ("#5b8c00", "#0072b2", "#e08a00", "#8a3ffc", "#d02670", "#007d79", "#a2191f")
_DASHES: Final = ((0, (4, 1)), (0, (2, 1)), (0, (5, 1, 1, 1)), (0, (3, 3)), (0, (7, 1)))
_MARKERS: Final = ("h", "d", "8", "H", "1", "2")


def controller_styles(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Keyword arguments of `Axes.plot` by controller; strangers get further styles in order."""
    styles = {}
    strangers = 0
    for name in names:
        style = _REGISTRY_STYLES.get(name)
        if style is None:
            style = {
                "color": _COLORS[strangers % len(_COLORS)],
                "linestyle": _DASHES[strangers % len(_DASHES)],
                "marker": _MARKERS[strangers % len(_MARKERS)],
            }
            strangers += 1
        styles[name] = {**style, "label": name}
    return styles


def draw_line(
    axes: Axes, x: Values, y: Values, style: dict[str, Any], line_index: int, **more: Any
) -> None:
    """Draw a line with a few markers, which are shifted from line to line."""
    every = max(1, len(x) // 6)
    start = (line_index * every) // 7 % every
    axes.plot(x, y, markevery=(start, every), **{"linewidth": 1.6, **style, **more})


def name_lines(figure: Figure, *panels: Axes) -> None:
    """Name the lines next to them, in the panel with the most room, or else in a legend."""
    figure.draw_without_rendering()  # computes the layout
    if label_lines(*panels, fontsize=10):
        return
    count = len(panels[0].get_legend_handles_labels()[1])
    columns = min(count, 4)
    figure.set_figheight(figure.get_figheight() + 0.27 * math.ceil(count / columns))
    legend_below(figure, columns, handlelength=3.2)


_DELAY_BINS: Final = 6
"""Number of bins of the delay in its figure (chosen: resolution against scatter)."""
_GAIN_AXIS_LIMITS: Final = (-8.0, 25.0)
"""Limits of the axis of effective gains, 1/s (chosen: hides outliers of feedforward motion)."""
_TIME_LABEL: Final = "time since the onset (s)"


_CAPTIONS: Final = {
    "tracking": "Tracking error and lag of each controller, with their intervals. The farther left "
    "its error, the better it keeps the moving target in sight.",
    "settle-times": "The share of trials that have settled, over time. A line further to the left "
    "is faster; one that stays low is a controller that does not settle in every trial.",
    "errors": "The larger error of both eyes, from when the target jumps or begins to move: the "
    "median of the trials (left) and the 95th of a hundred (right), which shows what happens in "
    "bad trials. The grey line is the band of settling.",
    "gains": "The gain that each controller amounts to, by the error in the image and by time. A "
    "level line is a law that is proportional to the error.",
    "delay": "Trials that settled, and their time, by the delay that the images really had. A "
    "level line is a controller that does not mind the delay.",
    "triangulation": "How far the point that gaze triangulates is from the target, over time: once "
    "the eyes have settled, what remains is the error of the model.",
}
"""Captions by kind of figure: its content and the conclusion to draw."""


def figure_caption(name: str) -> str:
    """Caption of a figure; empty if there is none."""
    return next((said for kind, said in _CAPTIONS.items() if name.startswith(f"{kind}-")), "")


def evaluation_figures(evaluation: Evaluation) -> dict[str, Figure]:
    """Draw all figures, by names such as `settle-times-workspace-kinematic`."""
    figures = {}
    with figure_style():
        for (scenario, plant), group in evaluation.groups().items():
            tail = f"{scenario}-{plant}"
            where = f"{scenario}, {plant}"
            if group[0].target_moves:
                figures[f"tracking-{tail}"] = _draw_tracking(
                    evaluation.summaries(scenario, plant), where
                )
            else:
                figures[f"settle-times-{tail}"] = _draw_settle_times(group, where)
            figures[f"errors-{tail}"] = _draw_errors(group, where)
            shown = [one for one in group if (one.effective_gains["by"] == "error").any()]
            if shown:
                figures[f"gains-{tail}"] = _draw_gains(shown, where)
            delays = group[0].trials.get("latency_s")
            if not group[0].target_moves and delays is not None and delays.nunique() > 1:
                figures[f"delay-{tail}"] = _draw_delays(group, where)
            if np.isfinite(group[0].curves["fix_error_p50_m"]).any():
                figures[f"triangulation-{tail}"] = _draw_triangulation(group, where)
    return figures


def _draw_settle_times(group: list[EvaluationResult], where: str) -> Figure:
    """Cumulative distribution of settle times, to the trial's end; a marker for the unsettled."""
    styles = controller_styles([*(one.controller for one in group), BOUND])
    duration, band = group[0].duration_s, SettlingBand(group[0].band_px)
    figure = new_figure(9.0, 4.8)
    axes = figure.subplots()
    times = {one.controller: one.trials[band.settle_s_column].to_numpy() for one in group}
    least = bound_trials([one.trials for one in group], band.px)
    times[BOUND] = least[band.bound_s_column].to_numpy()
    # trials that never settle: a marker beyond the trial's end, at the final settled fraction
    edge = 1.12 * duration
    for place, (name, settle) in enumerate(times.items()):
        known = np.sort(settle[np.isfinite(settle)])
        share = np.arange(1, len(known) + 1) / len(settle)
        last = share[-1] if len(known) else 0.0
        x = np.concatenate(([known[0]] if len(known) else [duration], known, [duration]))
        y = np.concatenate(([0.0], share, [last]))
        draw_line(axes, x, 100.0 * y, styles[name], place, drawstyle="steps-post")
        if len(known) < len(settle):
            style = {**styles[name], "linestyle": "none", "label": None}
            axes.plot([edge], [100.0 * last], clip_on=False, **style)
    starts = [np.nanmin(settle) for settle in times.values() if np.isfinite(settle).any()]
    axes.axvspan(duration, 1.24 * duration, color=GREY, alpha=0.12, linewidth=0.0)
    axes.annotate(
        "never settled", (edge, 1.01), xycoords=("data", "axes fraction"),
        ha="center", va="bottom", fontsize=10,
    )  # fmt: skip
    axes.set(
        xlim=(0.85 * min(starts), 1.24 * duration), ylim=(0.0, 101.0),
        xlabel=f"settle time to {band.px:g} px (s)", ylabel="trials settled by then (%)",
        title=f"Settle times: {where}",
    )  # fmt: skip
    log_axis(axes, "x")
    name_lines(figure, axes)
    return figure


def _draw_errors(group: list[EvaluationResult], where: str) -> Figure:
    """The worse eye's error over time: median and 95th percentile of the trials."""
    styles = controller_styles([one.controller for one in group])
    figure = new_figure(9.0, 4.2)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, level, title in zip(panels, ("50", "95"), ("median", "95th percentile"), strict=True):
        for place, one in enumerate(group):
            error = np.maximum(one.curves[f"error_p{level}_px"], 1e-3)
            draw_line(axes, one.curves["time_s"], error, styles[one.controller], place)
        axes.set(title=f"{title} of the trials", xlabel=_TIME_LABEL)
        log_axis(axes)
        axes.set_xlim(0.0, _last_s(group))
        if not group[0].target_moves:
            axes.axhline(group[0].band_px, color=GREY, linewidth=1.0)
    if group[0].target_moves:
        # the trial begins on the target: the axis starts at the later errors instead
        panels[0].set_ylim(bottom=0.5 * _least_late_error(group))
    least = " beyond the least" if has_residual(group) else ""
    panels[0].set_ylabel(f"error of the worse eye{least} (px)")
    figure.suptitle(
        f"{'Tracking' if group[0].target_moves else 'Pixel'} error: {where}", fontsize=12
    )
    name_lines(figure, *panels)
    return figure


def _last_s(group: list[EvaluationResult]) -> float:
    """Last time of a group's curves, s."""
    return max(float(one.curves["time_s"].iloc[-1]) for one in group)


def _least_late_error(group: list[EvaluationResult]) -> float:
    """The least median error of any controller in the later half of the trials, px."""
    late = [one.curves[one.curves["time_s"] > 0.5 * _last_s(group)] for one in group]
    return max(1e-3, min(float(curve["error_p50_px"].min()) for curve in late))


def _draw_gains(group: list[EvaluationResult], where: str) -> Figure:
    """Effective gain of each controller, by image error and by time."""
    styles = controller_styles([one.controller for one in group])
    figure = new_figure(9.0, 4.2)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, by in zip(panels, ("error", "time"), strict=True):
        for place, one in enumerate(group):
            rows = one.effective_gains[one.effective_gains["by"] == by]
            draw_line(axes, rows["at"], rows["gain_p50"], styles[one.controller], place)
    panels[0].set(xlabel="error in the image (px)", ylabel="effective gain (1/s)")
    panels[1].set(xlabel=_TIME_LABEL, xlim=(0.0, _last_s(group)))
    for axes in panels:
        axes.axhline(0.0, color=GREY, linewidth=1.0)
    # feedforward motion gives effective gains of any size and sign, which would hide the others
    low, high = panels[0].get_ylim()
    panels[0].set_ylim(max(low, _GAIN_AXIS_LIMITS[0]), min(high, _GAIN_AXIS_LIMITS[1]))
    log_axis(panels[0], "x")
    figure.suptitle(f"Gain that each controller amounts to, median: {where}", fontsize=12)
    name_lines(figure, *panels)
    return figure


def _draw_delays(group: list[EvaluationResult], where: str) -> Figure:
    """Settled fraction and median settle time by the true delay of the trials."""
    styles = controller_styles([one.controller for one in group])
    figure = new_figure(9.0, 4.2)
    left, right = figure.subplots(1, 2, sharex=True)
    for place, one in enumerate(group):
        table = _by_delay(one.trials, one.band_px)
        style = {**styles[one.controller], "markersize": 6}
        for axes, column, scale in ((left, "settled", 100.0), (right, "settle_s", 1.0)):
            x = 1000.0 * table["latency_s"] + 0.6 * (place - 0.5 * len(group)) / len(group)
            axes.plot(x, scale * table[column], **{**style, "linewidth": 1.4})
    low = min(90.0, left.get_ylim()[0])
    left.set(
        ylabel="trials settled (%)",
        title=f"Settled to {group[0].band_px:g} px",
        ylim=(max(low, 0.0), 101.0),
    )
    right.set(
        ylabel=f"settle time to {group[0].band_px:g} px (s)",
        title="Median, a failure as the whole trial",
    )
    log_axis(right)
    for axes in (left, right):
        axes.set_xlabel("true delay of the images (ms)")
    figure.suptitle(f"Robustness against the delay: {where}", fontsize=12)
    name_lines(figure, left, right)
    return figure


def _by_delay(trials: pd.DataFrame, band_px: float) -> pd.DataFrame:
    """Bin trials by delay: mean delay, settled fraction and median settle time of each bin."""
    values = imputed_trial_values(trials, band_px)
    delay, column = values["latency_s"], SettlingBand(band_px).settle_s_column
    settled = np.isfinite(trials[column])
    edges = np.linspace(delay.min(), delay.max() + 1e-9, _DELAY_BINS + 1)
    place = np.digitize(delay, edges) - 1
    rows = []
    for i in range(_DELAY_BINS):
        own = place == i
        if own.any():
            settle = float(median(values[column][own]))
            rows.append((delay[own].mean(), settled[own].mean(), settle))
    return pd.DataFrame(rows, columns=["latency_s", "settled", "settle_s"])


def _draw_triangulation(group: list[EvaluationResult], where: str) -> Figure:
    """Distance of the gaze fix from the target over time."""
    styles = controller_styles([one.controller for one in group])
    figure = new_figure(9.0, 4.0)
    axes = figure.subplots()
    for place, one in enumerate(group):
        error = 1000.0 * one.curves["fix_error_p50_m"]
        shown = np.where(np.isfinite(error), np.maximum(error, 1e-3), np.nan)
        draw_line(axes, one.curves["time_s"], shown, styles[one.controller], place)
    axes.set(
        xlabel=_TIME_LABEL, xlim=(0.0, _last_s(group)),
        ylabel="distance of the gaze fix\nfrom the target, median (mm)",
        title=f"Triangulation by gaze: {where}",
    )  # fmt: skip
    log_axis(axes)
    name_lines(figure, axes)
    return figure


def _draw_tracking(rows: list[dict[str, float]], where: str) -> Figure:
    """Tracking error and lag of each controller, with intervals."""
    names = [str(row["controller"]) for row in rows]
    styles = controller_styles(names)
    figure = new_figure(9.0, 1.7 + 0.34 * len(rows))
    left, right = figure.subplots(1, 2, sharey=True)
    for place, row in enumerate(rows):
        name = names[place]
        shape = {
            "color": styles[name]["color"], "marker": styles[name]["marker"], "markersize": 7,
            "linestyle": "none", "capsize": 4,
        }  # fmt: skip
        for axes, key, scale in (
            (left, "tracking_rms_px", 1.0),
            (right, "tracking_lag_median_s", 1000.0),
        ):
            value, low, high = (scale * row[f"{key}{end}"] for end in ("", "_low", "_high"))
            spread = [[max(value - low, 0.0)], [max(high - value, 0.0)]]
            axes.errorbar([value], [place], xerr=spread, **shape)
        if name == BASELINE:
            left.axvline(row["tracking_rms_px"], color=GREY, linewidth=1.0)
    left.set_yticks(range(len(names)), names)
    left.invert_yaxis()
    left.set(xlabel="tracking error, rms (px)", title="Error after the catch-up")
    log_axis(left, "x")
    right.axvline(0.0, color=GREY, linewidth=1.0)
    right.set(xlabel="lag behind the target (ms)", title="Lag")
    figure.suptitle(f"Tracking, medians of the trials: {where}", fontsize=12)
    return figure
