"""The summary of the static targets on the simulated rig: the article's figures beside ours."""

from typing import Final

import pandas as pd

from vergence.eval.article.common.simulated_cases import CASES
from vergence.eval.article.experiment import SummaryRow, compare
from vergence.eval.article.reported import Reported, reported_results
from vergence.eval.article.simulated_static.findings import (
    ARTICLE_CASE,
    ARTICLE_DETECTION_PX,
    ARTICLE_Z_PERCENT,
    EXPERIMENT,
    XY_WORST_MM,
    Z_MEDIAN_PERCENT,
    Z_WORST_PERCENT,
    Errors,
    find,
    reported,
    select,
)
from vergence.eval.article.simulated_static.trials import SimulatedStaticConfig

_UNREPORTED: Final = "not reported"


def summarise(table: pd.DataFrame, config: SimulatedStaticConfig) -> list[SummaryRow]:
    """The article's rows under its own camera matrix, then those of the other cases and targets.

    Verdicts beyond `reproduced`, `smaller` and `larger`: `target met` or `target missed` for what
    we want of the exact model, `inside` or `outside` the article's own range of detection noise,
    and `not reported` where the article has no figure.
    """
    found = find(table)
    rows = [_reported(row, select(table, ARTICLE_CASE)) for row in reported_results()
            if row.experiment == EXPERIMENT]  # fmt: skip
    for case, errors in found.errors.items():
        title = CASES[case].title
        rows.append(_depth_share(f"absolute error over depth, {title}", errors))
        if case != ARTICLE_CASE:
            rows += _case_errors(f"absolute error, {title}", errors)
    rows += _case_errors("absolute error, exact model, dithered", found.dithered)
    rows.append(_depth_share("absolute error over depth, exact model, dithered", found.dithered))
    rows += _targets("exact model", found.errors["exact"], 1.0)
    rows += _targets("exact model, dithered", found.dithered, 0.5)
    low, high = found.sigma_px
    rows.append(
        _row("detection noise", "both", "u, v", "px", low, high,
             compare(low, high, *ARTICLE_DETECTION_PX), ARTICLE_DETECTION_PX)
    )  # fmt: skip
    for axis, (low, high) in found.implied_px.items():
        inside = ARTICLE_DETECTION_PX[0] <= min(low, high) and (
            max(low, high) <= ARTICLE_DETECTION_PX[1]
        )
        rows.append(
            _row("detection noise implied by the article's uncertainty", "both", axis, "px",
                 min(low, high), max(low, high), "inside" if inside else "outside",
                 ARTICLE_DETECTION_PX)
        )  # fmt: skip
    exact = select(table, "exact")
    for method in ("gaze", "itpc"):
        for axis in "xyz":
            own = exact[(exact["method"] == method) & (exact["axis"] == axis)]
            spread = own["standard_deviation_mm"]
            rows.append(
                _row("standard deviation of single fixes", method, axis, "mm",
                     float(spread.min()), float(spread.max()), _UNREPORTED)
            )  # fmt: skip
    return rows


def _reported(row: Reported, case: pd.DataFrame) -> SummaryRow:
    """Ours beside one figure of the article's."""
    own = case[case["axis"] == row.axis]
    if row.method != "both":
        own = own[own["method"] == row.method]
    column = "error_mm" if row.quantity == "absolute error" else "uncertainty_mm"
    values = own[column].abs()
    low, high = float(values.min()), float(values.max())
    # where the article gives a least value only, the least of ours is compared
    verdict = compare(low, high if row.high is not None else low, row.low, row.high)
    return SummaryRow(
        experiment=EXPERIMENT, quantity=row.quantity, method=row.method, axis=row.axis, unit="mm",
        article_low=row.low, article_high=row.high, ours_low=low, ours_high=high, verdict=verdict,
    )  # fmt: skip


def _row(
    quantity: str, method: str, axis: str, unit: str, low: float, high: float, verdict: str,
    article: tuple[float | None, float | None] = (None, None),
) -> SummaryRow:  # fmt: skip
    return SummaryRow(
        experiment=EXPERIMENT, quantity=quantity, method=method, axis=axis, unit=unit,
        article_low=article[0], article_high=article[1], ours_low=low, ours_high=high,
        verdict=verdict,
    )  # fmt: skip


def _case_errors(quantity: str, errors: Errors) -> list[SummaryRow]:
    rows = []
    for axis in "xy":
        article = reported("absolute error", axis)
        low, high = errors.low_mm[axis], errors.high_mm[axis]
        verdict = compare(low, high, article.low, article.high)
        rows.append(
            _row(quantity, "both", axis, "mm", low, high, verdict, (article.low, article.high))
        )
    rows.append(
        _row(quantity, "both", "z", "mm", errors.low_mm["z"], errors.high_mm["z"], _UNREPORTED)
    )
    return rows


def _depth_share(quantity: str, errors: Errors) -> SummaryRow:
    low, _, high = errors.z_percent
    verdict = compare(high, high, ARTICLE_Z_PERCENT, None)
    return _row(quantity, "both", "z", "%", low, high, verdict, (None, ARTICLE_Z_PERCENT))


def _targets(title: str, errors: Errors, factor: float) -> list[SummaryRow]:
    """Our own targets: their limits stand where the article's figures would."""
    rows = []
    for what, axis, unit, value, limit in (
        ("greatest error over depth", "z", "%", errors.z_percent[2], Z_WORST_PERCENT),
        ("median error over depth", "z", "%", errors.z_percent[1], Z_MEDIAN_PERCENT),
        ("greatest error", "x", "mm", errors.high_mm["x"], XY_WORST_MM),
        ("greatest error", "y", "mm", errors.high_mm["y"], XY_WORST_MM),
    ):
        verdict = "target met" if value <= factor * limit else "target missed"
        quantity = f"{what}, {title}, target {factor * limit:g} {unit}"
        rows.append(_row(quantity, "both", axis, unit, value, value, verdict))
    return rows
