"""Report of margins: tables, text, a figure for each scenario, and the run folder."""

import math
from pathlib import Path
from typing import Final

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from vergence.errors import ConfigurationError
from vergence.eval.comparison.figures import controller_styles
from vergence.eval.comparison.folder import write_run_report
from vergence.eval.margins.run import IMPERFECTION_RANGES, RANGE_ENDS, Margin, Margins
from vergence.reporting.report import ReportTable
from vergence.reporting.runs import write_json
from vergence.reporting.style import BLACK, GREY, figure_style, new_figure
from vergence.reporting.text import SectionText, format_number, read_template, render_text

COLUMNS: Final = ("imperfection", "expected", "searched", "99 % settle", "median not doubled")


def report_tables(margins: Margins) -> list[ReportTable]:
    """Make a table for each controller in each scenario, with one row per imperfection."""
    return [
        ReportTable(
            title=f"{controller} in {scenario} on {margins.config.plants[0]}: "
            f"{group[0].points[0].trials} of {margins.config.trials} trials settle untouched",
            columns=list(COLUMNS),
            rows=[_row(one) for one in group],
        )
        for (scenario, controller), group in margins.groups().items()
    ]


def imperfection_title(imperfection: str) -> str:
    """Label of an imperfection, with the unit in which it is shown."""
    shown = IMPERFECTION_RANGES[imperfection]
    return f"{shown.label} ({shown.unit})" if shown.unit else shown.label


def _row(one: Margin) -> list[str]:
    def span(kind: str) -> str:
        low, high = f"{kind}_low", f"{kind}_high"
        if getattr(one, low) is None:
            return "nowhere"
        least = ("≤ " if one.is_open(low) else "") + _number(one, getattr(one, low))
        most = ("≥ " if one.is_open(high) else "") + _number(one, getattr(one, high))
        return f"{least} to {most}"

    return [
        imperfection_title(one.imperfection),
        _number(one, one.range.expected),
        f"{_number(one, one.range.low)} to {_number(one, one.range.high)}",
        span("settles"),
        span("doubles"),
    ]


def _number(one: Margin, value: float) -> str:
    """Format a value with three significant digits in the shown unit, without trailing zeros."""
    text = format_number(IMPERFECTION_RANGES[one.imperfection].scale * value)
    return text.rstrip("0").rstrip(".") if "." in text else text


LEGEND: Final = (
    "One imperfection at a time, the same for every trial, all else as the scenario has it. "
    "Expected: what the model says. 99 % settle: where of the trials that settle untouched 99 % "
    "still settle. Median not doubled: where their median settling time is less than twice the "
    "untouched one. ≤ and ≥: the end of what was searched, not of the margin."
)


def describe_margins(margins: Margins) -> SectionText:
    """Describe the margins, by `section.jinja`, as the text of their section."""
    groups = [
        {
            "controller": controller,
            "scenario": scenario,
            "count": len(group),
            "whole": sum(
                (one.settles_low, one.settles_high) == (one.range.low, one.range.high)
                for one in group
            ),
        }
        for (scenario, controller), group in margins.groups().items()
    ]
    return render_text(
        read_template("vergence.eval.margins"),
        groups=groups,
        trials=margins.config.trials,
        legend=LEGEND,
    )


_MOST_COLUMNS: Final = 4
"""Most panels side by side (chosen: legibility)."""
_FULL_WIDTH_IN: Final = 13.0
"""Width of a figure with all columns, inches (chosen: legibility)."""
_AXIS_MARGIN: Final = 0.05
"""Margin of the axis on either side, as a fraction of the searched range (chosen: legibility)."""


def margin_figures(margins: Margins) -> dict[str, Figure]:
    """Draw a figure for each scenario, by name."""
    with figure_style():
        return {
            f"margins-{scenario}": _draw(found, scenario)
            for scenario, found in margins.by_scenario().items()
        }


def _draw(found: list[Margin], scenario: str) -> Figure:
    controllers = list(dict.fromkeys(one.controller for one in found))
    names = list(dict.fromkeys(one.imperfection for one in found))
    columns = min(_MOST_COLUMNS, len(names))
    rows = math.ceil(len(names) / columns)
    height = rows * (0.85 + 0.27 * len(controllers)) + 0.9
    figure = new_figure(_FULL_WIDTH_IN * max(columns, 2) / _MOST_COLUMNS, height)
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    styles = controller_styles(controllers)
    for panel, name in zip(panels, names, strict=False):
        own = [one for one in found if one.imperfection == name]
        for one in own:
            _draw_bar(panel, one, controllers.index(one.controller), styles[one.controller])
        _dress(panel, own)
    for panel in panels[len(names) :]:
        panel.set_visible(False)
    panels[0].set_yticks(range(len(controllers)), controllers)
    panels[0].set_ylim(len(controllers) - 0.4, -0.6)
    figure.suptitle(f"Margins, one imperfection at a time: {scenario}", fontsize=13)
    figure.legend(handles=_legend(), loc="outside lower center", ncols=5 if columns > 2 else 2)
    return figure


def _draw_bar(panel: Axes, one: Margin, place: int, style: dict[str, object]) -> None:
    """Draw a wide light bar for the range "doubles" and a narrow dark one for "settles"."""
    color, scale = style["color"], IMPERFECTION_RANGES[one.imperfection].scale
    for kind, height, alpha in (("doubles", 0.74, 0.3), ("settles", 0.34, 1.0)):
        low, high = (getattr(one, f"{kind}_{end}") for end in ("low", "high"))
        if low is None:
            if kind == "settles":
                panel.plot([scale * one.range.expected], [place], "x", color=color, markersize=7)
            continue
        panel.barh(
            place, scale * (high - low), left=scale * low, height=height, color=color, alpha=alpha,
            # the edge keeps a range of zero width visible as a line
            edgecolor=color, linewidth=1.0, zorder=2 if kind == "doubles" else 3,
        )  # fmt: skip
    for end in RANGE_ENDS[:2]:
        if one.is_open(end):
            marker = "<" if end.endswith("low") else ">"
            panel.plot(
                [scale * getattr(one, end)], [place], marker, color=color, markersize=7,
                clip_on=False, zorder=4,
            )  # fmt: skip


def _dress(panel: Axes, own: list[Margin]) -> None:
    scale = IMPERFECTION_RANGES[own[0].imperfection].scale
    low = scale * min(one.range.low for one in own)
    high = scale * max(one.range.high for one in own)
    room = _AXIS_MARGIN * (high - low)
    panel.set_xlim(low - room, high + room)
    panel.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))
    panel.axvline(scale * own[0].range.expected, color=BLACK, linestyle=":", linewidth=1.3)
    panel.set_title(imperfection_title(own[0].imperfection), fontsize=11)
    panel.tick_params(axis="y", length=0)
    panel.grid(visible=False, axis="y")
    panel.spines["left"].set_visible(False)


def _legend() -> list[Patch | Line2D]:
    return [
        Patch(color=GREY, label="99 % settle"),
        Patch(color=GREY, alpha=0.3, label="median not doubled"),
        Line2D([], [], color=BLACK, linestyle=":", linewidth=1.3, label="expected"),
        Line2D([], [], color=GREY, marker=">", linestyle="none", label="end of the search"),
        Line2D([], [], color=GREY, marker="x", linestyle="none", label="settles nowhere"),
    ]


def write_margins(folder: Path, margins: Margins) -> None:
    """Write the tables, figures, configuration and report into an empty folder."""
    if not margins.margins:
        raise ConfigurationError("margins: expected at least one, got none")
    write_json(folder / "margins.json", margins.rows())
    _ranges(margins).to_csv(folder / "margins.csv", index=False)
    _points(margins).to_csv(folder / "points.csv", index=False)
    figures, text = margin_figures(margins), describe_margins(margins)
    write_run_report(
        folder,
        name="margins",
        title="How far a loop may be from its model",
        text=text,
        tables=report_tables(margins),
        figures=figures,
        captions=dict.fromkeys(figures, text.captions["margins"]),
        data_file="margins.csv",
        data_row_count=len(margins.margins),
        config=margins.config,
        notes=margins.notes,
        failures=margins.failures,
        outcomes=margins.margins,
    )


def _ranges(margins: Margins) -> pd.DataFrame:
    """The rows of margins.json with the expected value and the searched range."""
    return pd.DataFrame(
        [
            {
                **one.row(),
                "expected": one.range.expected,
                "searched_low": one.range.low,
                "searched_high": one.range.high,
            }
            for one in margins.margins
        ]
    )


def _points(margins: Margins) -> pd.DataFrame:
    """All measurements: one row per value of an imperfection."""
    return pd.DataFrame(
        [
            {
                "controller": one.controller,
                "scenario": one.scenario,
                "imperfection": one.imperfection,
                "unit": one.unit,
                **point._asdict(),
            }
            for one in margins.margins
            for point in one.points
        ]
    )
