"""Results of the static targets on the simulated rig, beside the article's figures."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from vergence.eval.article.common.closed_loop import gaze_uncertainty_mm
from vergence.eval.article.common.simulated_cases import CASES
from vergence.eval.article.experiment import SummaryRow
from vergence.eval.article.reported import (
    ReportedResult,
    reported_result,
    reported_results,
    static_points,
)
from vergence.eval.article.simulated_static.trials import SimulatedStaticConfig
from vergence.models.head_file import load_head
from vergence.models.parts import FloatArray
from vergence.reporting.text import Numbers

EXPERIMENT: Final = "simulated static"
"""Name of this experiment in the table of the article's results."""
ARTICLE_CASE: Final = "principal"
"""Case that represents the article's rig: Table 2's camera matrix on a centred image."""
ARTICLE_Z_PERCENT: Final = 0.5
"""Greatest absolute error in z, percent of depth (physical: reported by the article)."""
ARTICLE_DETECTION_PX: Final = (0.006, 0.057)
"""Least and greatest sample standard deviation of the detections, px (physical: reported by the
article)."""
# Our targets for errors of the mean fix with the exact model; half of them for dithered fixations
# (chosen). Greatest and median error in z, percent of depth; greatest error in x or y, mm.
Z_WORST_PERCENT: Final = 0.4
Z_MEDIAN_PERCENT: Final = 0.1
XY_WORST_MM: Final = 0.3
STANDARD_ERRORS: Final = 5.0
"""Largest error of a mean, in standard errors, attributed to chance (chosen)."""


def article_result(quantity: str, axis: str, method: str = "both") -> ReportedResult:
    """A result that the article reports of this experiment."""
    return reported_result(EXPERIMENT, quantity, method, axis)


def select_fixes(
    table: pd.DataFrame, case: str, fixation: str = "still", images: str = "rendered"
) -> pd.DataFrame:
    """The rows of one case and kind of fixation."""
    chosen = (table["case"] == case) & (table["fixation"] == fixation) & (table["images"] == images)
    return table[chosen]


@dataclass(frozen=True, kw_only=True)
class MeanFixErrors:
    """Absolute errors of the mean fixes of some rows, over points and methods."""

    low_mm: dict[str, float]
    """Least absolute error by axis, mm."""
    high_mm: dict[str, float]
    """Greatest absolute error by axis, mm."""
    z_percent: tuple[float, float, float]
    """Absolute error in z, percent of depth: least, median, greatest."""
    greatest_standard_errors: float
    """Greatest error of an ITPC mean, in standard errors from the scatter of its single fixes."""

    @staticmethod
    def of(rows: pd.DataFrame) -> "MeanFixErrors":
        """The errors of some rows."""
        absolute = rows["error_mm"].abs()
        by_axis = absolute.groupby(rows["axis"])
        deep = rows["axis"] == "z"
        share = 100.0 * absolute[deep] / rows["depth_mm"][deep]
        itpc = rows[rows["method"] == "itpc"]
        errors = itpc["error_mm"].abs() * np.sqrt(itpc["n"]) / itpc["standard_deviation_mm"]
        return MeanFixErrors(
            low_mm={axis: float(by_axis.min()[axis]) for axis in "xyz"},
            high_mm={axis: float(by_axis.max()[axis]) for axis in "xyz"},
            z_percent=(float(share.min()), float(share.median()), float(share.max())),
            greatest_standard_errors=float(errors.max()),
        )


def errors_by_case(table: pd.DataFrame) -> dict[str, MeanFixErrors]:
    """Errors of the still fixations of each case in the table."""
    still = {case: select_fixes(table, case) for case in CASES}
    return {case: MeanFixErrors.of(rows) for case, rows in still.items() if len(rows)}


def dithered_errors(table: pd.DataFrame) -> MeanFixErrors:
    """Errors of the exact model's dithered fixations."""
    return MeanFixErrors.of(select_fixes(table, "exact", "dithered"))


def numbers(table: pd.DataFrame, config: SimulatedStaticConfig) -> Numbers:
    """The numbers of the text."""
    del config
    cases, exact = errors_by_case(table), select_fixes(table, "exact")
    found: dict[str, float] = {
        "points": exact["point"].nunique(),
        "nearest_m": float(exact["depth_mm"].min()) / 1000.0,
        "farthest_m": float(exact["depth_mm"].max()) / 1000.0,
        "article_z_percent": ARTICLE_Z_PERCENT,
        "target_z_worst_percent": Z_WORST_PERCENT,
        "target_z_median_percent": Z_MEDIAN_PERCENT,
        "target_xy_mm": XY_WORST_MM,
        **_drawn_heads(table),
        **_methods_apart(table),
    }
    for name, errors in {**cases, "dithered": dithered_errors(table)}.items():
        for axis in "xyz":
            found[f"{name}_{axis}_low_mm"] = errors.low_mm[axis]
            found[f"{name}_{axis}_high_mm"] = errors.high_mm[axis]
        found[f"{name}_z_median_percent"] = errors.z_percent[1]
        found[f"{name}_z_high_percent"] = errors.z_percent[2]
        found[f"{name}_standard_errors"] = errors.greatest_standard_errors
    for axis in "xy":
        low, high = article_result("absolute error", axis).span
        found[f"article_{axis}_low_mm"], found[f"article_{axis}_high_mm"] = low, high
    implied = implied_noise_px()
    for axis, (near, far) in implied.items():
        found[f"implied_{axis}_near_px"], found[f"implied_{axis}_far_px"] = near, far
    found["implied_low_px"] = min(map(min, implied.values()))
    found["implied_high_px"] = max(map(max, implied.values()))
    found["article_noise_low_px"], found["article_noise_high_px"] = ARTICLE_DETECTION_PX
    found["noise_low_px"], found["noise_high_px"] = detection_noise_px(table)
    found["bias_high_px"] = float(exact.filter(like="detection_bias_").abs().to_numpy().max())
    return found


def detection_noise_px(table: pd.DataFrame) -> tuple[float, float]:
    """Least and greatest sample standard deviation of the detections with the exact model, px."""
    sigma = select_fixes(table, "exact").filter(like="detection_sigma_").to_numpy()
    return float(sigma.min()), float(sigma.max())


def _methods_apart(table: pd.DataFrame) -> dict[str, float]:
    """Numbers on the differences of both methods' means and scatter on settled targets."""
    rendered = pd.concat([select_fixes(table, case) for case in CASES])
    keys = ["case", "point", "axis"]
    wide = rendered.pivot_table(index=keys, columns="method", values="error_mm")
    difference = (wide["gaze"] - wide["itpc"]).abs()
    itpc = rendered[rendered["method"] == "itpc"].set_index(keys)
    error = itpc["standard_deviation_mm"] / np.sqrt(itpc["n"])
    exact = select_fixes(table, "exact")
    scatter = exact[exact["axis"] == "z"].pivot_table(
        index="point", columns="method", values="standard_deviation_mm"
    )
    return {
        "apart_high_mm": float(difference.max()),
        "apart_standard_errors": float((difference / error).max()),
        "scatter_ratio": float((scatter["gaze"] / scatter["itpc"]).median()),
    }


def _drawn_heads(table: pd.DataFrame) -> dict[str, float]:
    """Numbers comparing the drawn heads' errors with the article's in x and z together.

    A head counts as like the article's if its greatest error in x is within a factor of two of the
    article's and its greatest error in z, over depth, is not above the article's.
    """
    heads = select_fixes(table, "drawn", images="none")
    absolute = heads.assign(error_mm=heads["error_mm"].abs())
    worst = absolute.pivot_table(index="head", columns="axis", values="error_mm", aggfunc="max")
    deep = absolute[absolute["axis"] == "z"]
    share = (100.0 * deep["error_mm"] / deep["depth_mm"]).groupby(deep["head"]).max()
    _, article_x = article_result("absolute error", "x").span
    like = worst["x"].between(0.5 * article_x, 2.0 * article_x) & (share <= ARTICLE_Z_PERCENT)
    far = absolute[absolute["point"] == absolute["point"].max()]
    last = far.pivot_table(index="head", columns="axis", values="error_mm")
    depth = float(absolute["depth_mm"].max())
    return {
        "heads": len(worst),
        "heads_like_percent": 100.0 * float(like.mean()),
        "heads_z_over_x": float((last["z"] / last["x"]).median()),
        "article_z_over_x": ARTICLE_Z_PERCENT / 100.0 * depth / article_x,
    }


def implied_noise_px() -> dict[str, tuple[float, float]]:
    """Detection noise implied by each extreme of Fig. 7, px by axis.

    The least uncertainty is that at the nearest point, the greatest that at the farthest.
    """
    unit = uncertainty_mm_per_px()
    implied = {}
    for axis, letter in enumerate("xyz"):
        least, greatest = article_result("uncertainty", letter).span
        implied[letter] = (float(least / unit[0, axis]), float(greatest / unit[-1, axis]))
    return implied


def uncertainty_mm_per_px() -> FloatArray:
    """(21, 3) uncertainty at Table 3's points per pixel of detection noise, mm/px."""
    head, points = load_head("simulated"), static_points("simulated")
    return gaze_uncertainty_mm(head, head.fixate(points), np.ones((len(points), 2, 2)))


def summarise(table: pd.DataFrame, config: SimulatedStaticConfig) -> list[SummaryRow]:
    """Rows of the summary: the article's under its own camera matrix, other cases, our targets.

    Verdicts beyond those of `verdict_of_ranges`: `target met` or `target missed` for our targets of
    the exact model, and `inside` or `outside` the article's own range of detection noise.
    """
    rows = [_reported(row, select_fixes(table, ARTICLE_CASE)) for row in reported_results()
            if row.experiment == EXPERIMENT]  # fmt: skip
    cases, dithered = errors_by_case(table), dithered_errors(table)
    for case, errors in cases.items():
        title = CASES[case].title
        rows.append(_depth_share(title, errors))
        if case != ARTICLE_CASE:
            rows += _case_errors(title, errors)
    rows += _case_errors("exact model, dithered", dithered)
    rows.append(_depth_share("exact model, dithered", dithered))
    rows += _targets("exact model", cases["exact"], 1.0)
    rows += _targets("exact model, dithered", dithered, 0.5)
    low, high = ARTICLE_DETECTION_PX
    ours = detection_noise_px(table)
    rows.append(_row("detection noise", "both", "u, v", ARTICLE_DETECTION_PX, ours, unit="px"))
    for axis, pair in implied_noise_px().items():
        span = (min(pair), max(pair))
        verdict = "inside" if low <= span[0] and span[1] <= high else "outside"
        quantity = "detection noise implied by the article's uncertainty"
        rows.append(_row(quantity, "both", axis, ARTICLE_DETECTION_PX, span, verdict, "px"))
    for (method, letter), own in select_fixes(table, "exact").groupby(["method", "axis"]):
        scatter = own["standard_deviation_mm"]
        ours, quantity = (scatter.min(), scatter.max()), "standard deviation of single fixes"
        rows.append(_row(quantity, str(method), str(letter), None, ours))
    return rows + _explanations(numbers(table, config))


def _row(
    quantity: str, method: str, axis: str, theirs: tuple[float | None, float | None] | None,
    ours: tuple[float, float] | float, verdict: str | None = None, unit: str = "mm",
) -> SummaryRow:  # fmt: skip
    return SummaryRow.of(EXPERIMENT, quantity, method, axis, theirs, ours, verdict, unit)


def _reported(row: ReportedResult, case: pd.DataFrame) -> SummaryRow:
    """Summary row of our range beside one of the article's."""
    own = case[case["axis"] == row.axis]
    if row.method != "both":
        own = own[own["method"] == row.method]
    column = "error_mm" if row.quantity == "absolute error" else "uncertainty_mm"
    values = own[column].abs()
    low, high = float(values.min()), float(values.max())
    return _row(row.quantity, row.method, row.axis, (row.low, row.high), (low, high))


def _case_errors(title: str, errors: MeanFixErrors) -> list[SummaryRow]:
    rows = []
    for axis in "xyz":
        theirs = None if axis == "z" else article_result("absolute error", axis).span
        ours = (errors.low_mm[axis], errors.high_mm[axis])
        rows.append(_row(f"absolute error, {title}", "both", axis, theirs, ours))
    return rows


def _depth_share(title: str, errors: MeanFixErrors) -> SummaryRow:
    low, _, high = errors.z_percent
    quantity, theirs = f"absolute error over depth, {title}", (None, ARTICLE_Z_PERCENT)
    return _row(quantity, "both", "z", theirs, (low, high), unit="%")


def _targets(title: str, errors: MeanFixErrors, factor: float) -> list[SummaryRow]:
    """Summary rows on our own targets for a case."""
    _, median, worst = errors.z_percent
    return [
        _target(f"{what}, {title}", "both", axis, value, factor * limit, unit)
        for what, axis, unit, value, limit in (
            ("greatest error over depth", "z", "%", worst, Z_WORST_PERCENT),
            ("median error over depth", "z", "%", median, Z_MEDIAN_PERCENT),
            ("greatest error", "x", "mm", errors.high_mm["x"], XY_WORST_MM),
            ("greatest error", "y", "mm", errors.high_mm["y"], XY_WORST_MM),
        )
    ]


def _target(
    quantity: str, method: str, axis: str, value: float, limit: float, unit: str
) -> SummaryRow:
    verdict = "target met" if value <= limit else "target missed"
    return _row(f"{quantity}, target {limit:g} {unit}", method, axis, None, value, verdict, unit)


def _explanations(found: Numbers) -> list[SummaryRow]:
    """Summary rows on errors beyond chance, and on drawn errors like the article's."""
    unit, all_axes = "standard errors", "x, y, z"
    ratio, theirs = found["heads_z_over_x"], found["article_z_over_x"]
    return [
        _target(quantity, method, all_axes, found[f"{name}_standard_errors"], STANDARD_ERRORS, unit)
        for quantity, method, name in (
            ("greatest difference of the methods' means", "both", "apart"),
            ("greatest error of the mean, exact model", "itpc", "exact"),
            ("greatest error of the mean, exact model, dithered", "itpc", "dithered"),
        )
    ] + [
        _row("error in z over error in x at the farthest point, drawn heads", "gaze", "x, z",
             (None, theirs), ratio, unit="1"),
        _row("drawn heads with the article's errors in x and z", "gaze", "x, z", None,
             found["heads_like_percent"], unit="%"),
    ]  # fmt: skip
