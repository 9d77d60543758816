"""An evaluation in words: the cells of its tables, and the sentence that the numbers amount to."""

import math
from collections.abc import Mapping
from typing import Any, Final

from vergence.eval.comparison.contestants import BASELINE, BOUND
from vergence.eval.comparison.evaluation import Evaluation
from vergence.eval.reporting.report import ReportTable
from vergence.eval.reporting.text import format_number

_NONE: Final = "–"
SETTLING_COLUMNS: Final = (
    "controller", "settled (%)", "settle (ms)", "95 % within (ms)", "x bound",
    "overshoot (%)", "lost (%)", "x faster", "predict (us)",
)  # fmt: skip
MOVING_COLUMNS: Final = (
    "controller", "tracking (px)", "95 % within (px)", "lag (ms)", "lost (%)", "x nearer",
    "predict (us)",
)  # fmt: skip


def tables(evaluation: Evaluation) -> list[ReportTable]:
    """A table for each scenario and plant; medians with their intervals.

    Args:
        evaluation: what to show.

    Returns:
        The tables. A cell may have a second line: in the first column the options that ran.
    """
    found = []
    rows = evaluation.summaries()
    for (scenario, plant), group in evaluation.groups().items():
        own = [row for row in rows if (row["scenario"], row["plant"]) == (scenario, plant)]
        moving = group[0].moving
        found.append(
            ReportTable(
                title=f"{scenario} on {plant}: {len(group[0].trials)} trials of "
                f"{group[0].duration_s:g} s",
                columns=list(MOVING_COLUMNS if moving else SETTLING_COLUMNS),
                rows=[(_moving_row if moving else _settling_row)(row) for row in own],
            )
        )
    return found


def _settling_row(row: dict[str, Any]) -> list[str]:
    return [
        _name(row),
        _share(row, "settled_fraction"),
        _cell(row, "settle_1px_median_s", 1000.0),
        _number(row, "settle_1px_p95_s", 1000.0),
        _cell(row, "ratio_to_bound_median"),
        _stacked(row, "overshoot_median", "overshoot_p95", 100.0),
        _share(row, "lost_fraction"),
        _cell(row, "faster"),
        _stacked(row, "predict_us", "predict_one_us"),
    ]


def _moving_row(row: dict[str, Any]) -> list[str]:
    return [
        _name(row),
        _cell(row, "tracking_rms_px"),
        _number(row, "tracking_rms_p95_px"),
        _number(row, "tracking_lag_median_s", 1000.0),
        _share(row, "lost_fraction"),
        _cell(row, "faster"),
        _stacked(row, "predict_us", "predict_one_us"),
    ]


LEGEND: Final = (
    "Settle: the median time to 1 px; tracking: the median of the trials' rms errors. Below a "
    "median its 95 % interval by bootstrap. A trial that never settles counts as the whole trial "
    "in every time and ratio. Overshoot: the median, below it the 95th percentile. x faster, x "
    f"nearer: than {BASELINE} on the same trials. Predict: for one head in the batch, below it "
    "alone."
)

LEGEND_WITHOUT_INTERVALS: Final = LEGEND.replace(
    "Below a median its 95 % interval by bootstrap", "Intervals are in the report"
)


_MOST_OPTIONS: Final = 3


def _name(row: dict[str, Any]) -> str:
    if row["controller"] == BOUND:
        return f"{BOUND}\ntime-optimal"
    return f"{row['controller']}\n{_describe(row['options'])}"


def _describe(options: Mapping[str, Any]) -> str:
    """A controller's options in one line; many are counted, and named in summary.csv."""
    if not options:
        return "its defaults"
    shown = {key: value for key, value in options.items() if key != "scenario"}
    if len(shown) > _MOST_OPTIONS:
        return f"{len(shown)} tuned options"
    return ", ".join(f"{key} {_short(value)}" for key, value in shown.items())


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)[:12]


def _number(row: dict[str, Any], key: str, scale: float = 1.0) -> str:
    value = row.get(key, math.nan)
    return format_number(scale * value) if math.isfinite(value) else _NONE


def _share(row: dict[str, Any], key: str) -> str:
    """A fraction in per cent, never rounded to all or to nothing."""
    value = row.get(key, math.nan)
    return f"{100.0 * value:.6g}" if math.isfinite(value) else _NONE


def _with_interval(row: dict[str, Any], key: str, scale: float = 1.0) -> str:
    value = _number(row, key, scale)
    low, high = _number(row, f"{key}_low", scale), _number(row, f"{key}_high", scale)
    return value if low == high else f"{value} [{low}, {high}]"


def _cell(row: dict[str, Any], key: str, scale: float = 1.0) -> str:
    value = _with_interval(row, key, scale)
    return value.replace(" [", "\n").replace(", ", "–").replace("]", "")


def _stacked(row: dict[str, Any], one: str, other: str, scale: float = 1.0) -> str:
    first, second = _number(row, one, scale), _number(row, other, scale)
    return _NONE if first == second == _NONE else f"{first}\n{second}"


def conclude(evaluation: Evaluation) -> str:
    """What the numbers say: a line of a sentence or two for each scenario and plant.

    Args:
        evaluation: what to sum up.

    Returns:
        The lines.
    """
    rows = evaluation.summaries()
    said = []
    for (scenario, plant), group in evaluation.groups().items():
        own = [
            row
            for row in rows
            if (row["scenario"], row["plant"]) == (scenario, plant) and row["controller"] != BOUND
        ]
        said.append((_say_moving if group[0].moving else _say_settling)(own, scenario, plant))
    return "\n".join(said)


def _say_settling(rows: list[dict[str, Any]], scenario: str, plant: str) -> str:
    best = min(rows, key=lambda row: row["settle_1px_median_s"])
    text = (
        f"On {scenario} ({plant}) {best['controller']} is the fastest: it settles to 1 px in "
        f"{_with_interval(best, 'settle_1px_median_s', 1000.0)} ms in the median, "
        f"{_number(best, 'ratio_to_bound_median')} times the time-optimal bound"
    )
    text += _against_baseline(best, "faster")
    text += f", and in {_share(best, 'settled_fraction')} % of the trials."
    surest = max(rows, key=lambda row: row["settled_fraction"])
    if surest["settled_fraction"] > best["settled_fraction"]:
        text += (
            f" {surest['controller']} settles in more of them, "
            f"{_share(surest, 'settled_fraction')} %."
        )
    failing = [row for row in rows if row["settled_fraction"] < 0.95]
    if failing:
        names = ", ".join(
            f"{row['controller']} ({_share(row, 'settled_fraction')} %)" for row in failing
        )
        text += f" Fewer than 95 % of the trials settle with {names}."
    return text


def _say_moving(rows: list[dict[str, Any]], scenario: str, plant: str) -> str:
    best = min(rows, key=lambda row: row["tracking_rms_px"])
    text = (
        f"On {scenario} ({plant}) {best['controller']} follows most closely, with "
        f"{_with_interval(best, 'tracking_rms_px')} px rms in the median"
    )
    if math.isfinite(best["tracking_lag_median_s"]):
        text += f" and {_number(best, 'tracking_lag_median_s', 1000.0)} ms of lag"
    return f"{text}{_against_baseline(best, 'nearer')}."


def _against_baseline(row: dict[str, Any], how: str) -> str:
    if row["controller"] == BASELINE or not math.isfinite(row.get("faster", math.nan)):
        return ""
    return f", {_with_interval(row, 'faster')} times {how} than {BASELINE}"
