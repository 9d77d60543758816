"""An evaluation's tables and text for its report and the terminal."""

import math
from operator import itemgetter
from typing import Any, Final

from vergence.eval.comparison.contestants import BASELINE, BOUND, UNTUNED
from vergence.eval.comparison.evaluate import Evaluation, EvaluationResult
from vergence.eval.comparison.statistics import SWINGING
from vergence.eval.head_summary import LEAST_RESIDUAL_PX
from vergence.eval.trials.settling import ONE_PX, SettlingBand, bands_with_bound
from vergence.reporting.report import ReportTable
from vergence.reporting.text import (
    NONE,
    SectionText,
    format_number,
    read_template,
    render_text,
)

SETTLING_COLUMNS: Final = (
    "controller", "settled (%)", "time to settle (ms)", "95 % within (ms)", "x bound",
    "x faster", "lost (%)", "left again (%)", "overshoot (%)", "speed at rest (deg/s)",
    "compute (µs)",
)  # fmt: skip
MOVING_COLUMNS: Final = (
    "controller", "error (px)", "95 % within (px)", "lag (ms)", "x nearer", "lost (%)",
    "compute (µs)",
)  # fmt: skip
_PEAK_TO_PEAK_COLUMNS: Final = (
    "fixation_peak_to_peak_median_rad_s",
    "fixation_peak_to_peak_p95_rad_s",
)
_DEGREES_PER_RADIAN: Final = math.degrees(1.0)
"""Degrees per radian (physical: conversion of units)."""
_ZERO_TOLERANCE: Final = 1e-6
"""Magnitude below which tables show 0, such as rounding errors in the speed of eyes at rest
(numerical)."""
RESIDUAL_COLUMN: Final = "residual (px)"
ONE_PIXEL_COLUMN: Final = "1 px (ms)"


def report_tables(evaluation: Evaluation) -> list[ReportTable]:
    """Make a table for each scenario and plant; in the first column are the options too."""
    found = []
    for (scenario, plant), group in evaluation.groups().items():
        target_moves = group[0].target_moves
        found.append(
            ReportTable(
                title=f"{scenario} on {plant}: {len(group[0].trials)} trials of "
                f"{group[0].duration_s:g} s, head {group[0].head.name}"
                + ("" if target_moves else f", settled within {group[0].band_px:g} px"),
                columns=_columns(group),
                rows=[
                    _moving_row(row) if target_moves else _settling_row(row, group)
                    for row in evaluation.summaries(scenario, plant)
                ],
            )
        )
    return found


def _columns(group: list[EvaluationResult]) -> list[str]:
    """Column titles; the column of ratios says if the baseline is untuned or has given options."""
    columns = list(MOVING_COLUMNS if group[0].target_moves else SETTLING_COLUMNS)
    if not group[0].target_moves and group[0].band_px != 1.0:
        columns.insert(columns.index("x bound"), ONE_PIXEL_COLUMN)
    if has_residual(group):
        columns.insert(columns.index("overshoot (%)"), RESIDUAL_COLUMN)
    mark = _mark_of_baseline(group)
    which = {"": BASELINE, UNTUNED: "untuned"}.get(mark, "given")
    ratios = {name: f"{name} than {which}" for name in ("x faster", "x nearer")}
    return [ratios.get(column, column) for column in columns]


def has_residual(group: list[EvaluationResult]) -> bool:
    """True if a target at rest has a residual: a least error that the head can reach above 0."""
    return bool((group[0].trials["residual_px"] >= LEAST_RESIDUAL_PX).any())


def _mark_of_baseline(group: list[EvaluationResult]) -> str:
    """Mark of the baseline's options: given or untuned; empty otherwise."""
    baseline = next((one for one in group if one.controller == BASELINE), None)
    if baseline is None:
        return ""
    if baseline.given:
        return "with the options that were given"
    return UNTUNED if baseline.tuned is False else ""


def _named_baseline(group: list[EvaluationResult]) -> str:
    mark = _mark_of_baseline(group)
    return f"{BASELINE}, {mark}," if mark else BASELINE


def _settling_row(row: dict[str, Any], group: list[EvaluationResult]) -> list[str]:
    band = SettlingBand(group[0].band_px)
    return [
        _label(row),
        _with_swinging(_share(row, band.settled_fraction_column), row),
        _cell(row, band.settle_median_s_column, 1000.0),
        _number(row, band.settle_p95_s_column, 1000.0),
        *([_number(row, ONE_PX.settle_median_s_column, 1000.0)] if group[0].band_px != 1.0 else []),
        _cell(row, band.ratio_median_column),
        _cell(row, "faster"),
        _share(row, "lost_fraction"),
        _share(row, "left_again_fraction"),
        *([_stacked(row, "residual_px", "residual_p95_px")] if has_residual(group) else []),
        _stacked(row, "overshoot_median", "overshoot_p95", 100.0),
        _stacked(row, *_PEAK_TO_PEAK_COLUMNS, _DEGREES_PER_RADIAN),
        _stacked(row, "predict_us", "predict_one_us"),
    ]


def _moving_row(row: dict[str, Any]) -> list[str]:
    return [
        _label(row),
        _cell(row, "tracking_rms_px"),
        _number(row, "tracking_rms_p95_px"),
        _number(row, "tracking_lag_median_s", 1000.0),
        _cell(row, "faster"),
        _share(row, "lost_fraction"),
        _stacked(row, "predict_us", "predict_one_us"),
    ]


_SETTLING_HINT: Final = (
    "Time to settle: until both eyes stay on the target; x bound: ratio to the fastest possible. "
)
_MOVING_HINT: Final = "Error: distance of the target's image from the centre, rms. "
_LEGEND: Final = (
    "Time to settle: the median time to the band; error: the median of the trials' rms errors. "
    "Below a median its 95 % interval by bootstrap. "
    "A trial that never settles counts as the whole trial in every time, and no ratio is made from "
    "it. Swing: how many trials go on swinging, none of which counts as settled. x bound: the "
    "median ratio to the fastest possible time of the same trial. x faster, x nearer: than "
    f"{BASELINE} on the same trials, below 1 slower or farther. Left again: the trials that left "
    "the band after 0.1 s in it. Overshoot: the median, below it the 95th percentile. Speed at "
    "rest: of the worst joint while fixating, peak to peak, the median and below it the 95th "
    "percentile. Compute: predict's time for one head in the batch, below it alone."
)
_RESIDUAL_LEGEND: Final = (
    " Residual: the least error that the head's actuators can reach, of the worse eye, the median "
    "and below it the 95th percentile; settling and overshoot are counted from there."
)
_LINEAR_LEGEND: Final = (
    " Linear law: the periods of all trials in which it acted in the network's place, as the eyes "
    "oscillated or the servos' own loop overshoots."
)
_UNTUNED_LEGEND: Final = (
    " Untuned for this head: no options have been found for it, and those of another head run, or "
    "the controller's defaults; tuned, it may do better."
)


def table_hint(evaluation: Evaluation) -> str:
    """The tables' leading columns in a sentence or two."""
    moves = {group[0].target_moves for group in evaluation.groups().values()}
    hints = {False: _SETTLING_HINT, True: _MOVING_HINT}
    leading = "".join(hint for moving, hint in hints.items() if moving in moves)
    return f"{leading}Below: 95 % interval or percentile."


def table_legend(evaluation: Evaluation) -> str:
    """Explanation of the tables' columns and marks."""
    text = _LEGEND
    if any(has_residual(group) for group in evaluation.groups().values()):
        text += _RESIDUAL_LEGEND
    if any(one.tuned is False for one in evaluation.outcomes):
        text += _UNTUNED_LEGEND
    if any(math.isfinite(one.summary["linear_law_fraction"]) for one in evaluation.outcomes):
        text += _LINEAR_LEGEND
    return text


_MOST_OPTIONS: Final = 3
"""Most options that a table lists; more are counted (chosen: room of a line)."""


def _label(row: dict[str, Any]) -> str:
    if row["controller"] == BOUND:
        return f"{BOUND}\nfastest possible"
    return f"{row['controller']}\n{_describe(row)}"


def _describe(row: dict[str, Any]) -> str:
    """A controller's options in one line; if they are many, their number (summary.csv has all)."""
    shown = {key: value for key, value in row["options"].items() if key != "scenario"}
    text = ", ".join(f"{key} {_short(value)}" for key, value in shown.items())
    if len(shown) > _MOST_OPTIONS:
        text = f"{len(shown)} {'tuned ' if row['tuned'] else ''}options"
    marks = [UNTUNED] if row["tuned"] is False else []
    marks += ["given by --options"] if row["given"] else []
    if math.isfinite(row.get("linear_law_fraction", math.nan)):
        marks.append(f"linear law {_share(row, 'linear_law_fraction')} %")
    return ", ".join([text or "its defaults", *marks])


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)[:12]


def _number(row: dict[str, Any], key: str, scale: float = 1.0) -> str:
    value = row.get(key, math.nan)
    no_residual = key.startswith("residual") and abs(value) < LEAST_RESIDUAL_PX
    nothing = no_residual or abs(scale * value) < _ZERO_TOLERANCE
    return format_number(0.0 if nothing else scale * value)


def _share(row: dict[str, Any], key: str) -> str:
    """A fraction in per cent, never rounded to exactly 0 or 100."""
    value = row.get(key, math.nan)
    if not math.isfinite(value):
        return NONE
    text = f"{100.0 * value:.3g}"
    return f"{100.0 * value:.6g}" if text in ("0", "100") else text


def _with_swinging(settled: str, row: dict[str, Any]) -> str:
    """The settled fraction, and below it the number of trials that swing, if any do."""
    swinging = row.get(SWINGING, math.nan)
    return f"{settled}\n{int(swinging)} swing" if swinging > 0 else settled


def _with_interval(row: dict[str, Any], key: str, scale: float = 1.0) -> str:
    value = _number(row, key, scale)
    low, high = _number(row, f"{key}_low", scale), _number(row, f"{key}_high", scale)
    return value if low == high else f"{value} [{low}, {high}]"


def _cell(row: dict[str, Any], key: str, scale: float = 1.0) -> str:
    value = _with_interval(row, key, scale)
    return value.replace(" [", "\n").replace(", ", "–").replace("]", "")


def _stacked(row: dict[str, Any], one: str, other: str, scale: float = 1.0) -> str:
    first, second = _number(row, one, scale), _number(row, other, scale)
    return NONE if first == second == NONE else f"{first}\n{second}"


def describe_evaluation(evaluation: Evaluation) -> SectionText:
    """Describe the evaluation and its best results per scenario and plant, by `section.jinja`."""
    groups = []
    for (scenario, plant), group in evaluation.groups().items():
        band = SettlingBand(group[0].band_px)
        judged = "tracking_rms_px" if group[0].target_moves else band.settle_median_s_column
        rivals = [r for r in evaluation.summaries(scenario, plant) if r["controller"] != BOUND]
        groups.append(
            {
                "scenario": scenario,
                "plant": plant,
                "target_moves": group[0].target_moves,
                "baseline": _named_baseline(group),
                "best": min(rivals, key=itemgetter(judged)),
                "least": min(rivals, key=itemgetter(band.settled_fraction_column)),
                "band": band,
                "band_px": group[0].band_px,
            }
        )
    return render_text(
        read_template("vergence.eval.comparison"),
        groups=groups,
        bands=_listed(evaluation),
        robot=evaluation.config.on_robot,
        residual=any(has_residual(group) for group in evaluation.groups().values()),
        legend=table_legend(evaluation),
        number=_number,
        interval=_with_interval,
        share=_share,
    )


def _listed(evaluation: Evaluation) -> str:
    """The settling bands of all scenarios as text, such as "1 or 2"."""
    bands = {band for one in evaluation.outcomes for band in bands_with_bound(one.band_px)}
    *others, last = (f"{band.px:g}" for band in sorted(bands))
    return f"{', '.join(others)} or {last}"
