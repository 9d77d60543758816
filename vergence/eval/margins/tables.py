"""Tables of margins for the report and the terminal, and the text about them."""

from typing import Final

from vergence.eval.margins.margins import Margin, Margins
from vergence.eval.margins.ranges import IMPERFECTION_RANGES
from vergence.reporting.report import ReportTable
from vergence.reporting.text import SectionText, format_number, read_template, render_text

COLUMNS: Final = ("imperfection", "expected", "searched", "99 % settle", "median not doubled")
_NO_RANGE_TEXT: Final = "nowhere"


def report_tables(margins: Margins) -> list[ReportTable]:
    """Make a table for each controller in each scenario, with one row per imperfection.

    Args:
        margins: the margins.
    """
    return [
        ReportTable(
            title=f"{controller} in {scenario} on {margins.config.plants[0]}: "
            f"{_settled(group)} of {margins.config.trials} trials settle untouched",
            columns=list(COLUMNS),
            rows=[_row(one) for one in group],
        )
        for (scenario, controller), group in margins.groups().items()
    ]


def imperfection_title(imperfection: str) -> str:
    """Label of an imperfection, with the unit in which it is shown.

    Args:
        imperfection: name of the imperfection.
    """
    shown = IMPERFECTION_RANGES[imperfection]
    return f"{shown.label} ({shown.unit})" if shown.unit else shown.label


def _settled(group: list[Margin]) -> int:
    return group[0].points[0].trials


def _row(one: Margin) -> list[str]:
    def span(kind: str) -> str:
        low, high = f"{kind}_low", f"{kind}_high"
        if getattr(one, low) is None:
            return _NO_RANGE_TEXT
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
    """Describe the margins, by `section.jinja`.

    Args:
        margins: the margins.

    Returns:
        The text of its section in a report.
    """
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
