"""Figures of tuning: a curve for a single option, or a scatter panel for each of several."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from vergence.eval.tuning.objective import Attempt
from vergence.eval.tuning.spaces import SearchRange
from vergence.reporting.style import BLUE, GREY, ORANGE, figure_style, legend_below, new_figure

_METRIC_LABELS = {"s": "settle time (s)", "px": "tracking RMS (px)"}


def draw_search(
    attempts: Sequence[Attempt], search_ranges: Mapping[str, SearchRange], title: str, unit: str
) -> Figure:
    """Draw the headline metric against the options.

    Args:
        attempts: the points tried.
        search_ranges: search range of each option.
        title: title of the figure.
        unit: unit of the metric, `s` or `px`.

    Returns:
        A curve for a single option; for several, one panel each, in which the other options vary
        too.
    """
    best = min(attempts, key=lambda attempt: attempt.rank)
    with figure_style():
        if len(search_ranges) == 1:
            figure = _curve(attempts, best, next(iter(search_ranges)), unit)
        else:
            figure = _slices(attempts, best, search_ranges, unit)
        figure.suptitle(title, fontsize=12)
    return figure


def _curve(attempts: Sequence[Attempt], best: Attempt, name: str, unit: str) -> Figure:
    figure = new_figure(9.0, 4.4)
    axes = figure.subplots()
    ordered = sorted(attempts, key=lambda attempt: attempt.options[name])
    x = np.array([attempt.options[name] for attempt in ordered])
    for key, style in (
        ("headline", {"color": BLUE, "linestyle": "-", "label": "median"}),
        ("mean", {"color": GREY, "linestyle": "--", "label": "mean", "linewidth": 1.2}),
    ):
        axes.plot(x, [attempt.results[key] for attempt in ordered], **style)
    at = best.options[name]
    axes.plot(at, best.results["headline"], "o", color=ORANGE, markersize=8)
    axes.annotate(
        f"{name} = {at:g}: {best.results['headline']:.3f} {unit}",
        (at, best.results["headline"]),
        xytext=(10, -4),
        textcoords="offset points",
        va="top",
        color=ORANGE,
    )
    axes.margins(y=0.12)
    axes.set(xlabel=f"{name} (1/s)" if "gain" in name else name, ylabel=_METRIC_LABELS[unit])
    legend_below(figure, 2)
    return figure


def _slices(
    attempts: Sequence[Attempt], best: Attempt, search_ranges: Mapping[str, SearchRange], unit: str
) -> Figure:
    columns = min(4, len(search_ranges))
    rows = -(-len(search_ranges) // columns)
    figure = new_figure(3.0 * columns + 1.2, 3.1 * rows + 0.4)
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
    value = [attempt.results["headline"] for attempt in attempts]
    number = [attempt.number for attempt in attempts]
    for axes in panels.flat[len(search_ranges) :]:
        axes.set_visible(False)
    for axes, (name, span) in zip(panels.flat, search_ranges.items(), strict=False):
        x = [attempt.options[name] for attempt in attempts]
        dots = axes.scatter(x, value, c=number, cmap="viridis", s=16, linewidths=0)
        axes.plot(
            best.options[name],
            best.results["headline"],
            "o",
            markersize=11,
            markerfacecolor="none",
            markeredgecolor=ORANGE,
            markeredgewidth=2.0,
        )
        axes.set_xscale(span.scale)
        axes.set(xlabel=name, title=f"best: {best.options[name]:.4g}")
        axes.title.set_color(ORANGE)
    for row in panels:
        row[0].set_ylabel(_METRIC_LABELS[unit])
    figure.colorbar(dots, ax=panels, label="attempt")
    return figure
