"""Results of static targets on the physical twin: summary rows, and the numbers of the text."""

from collections.abc import Iterator
from typing import Final

import numpy as np
import pandas as pd

from vergence.eval.article.criterion import BY_CONSTRUCTION
from vergence.eval.article.experiment import SummaryRow
from vergence.eval.article.physical_static.error_budget import (
    ALL,
    BUDGET_SOURCES,
    ENCODERS,
    SOURCE_LABELS,
    crossover_px,
)
from vergence.eval.article.physical_static.trials import (
    ARTICLE_LARGEST_PERCENT,
    PhysicalStaticConfig,
)
from vergence.eval.article.reported import ReportedResult, reported_result, reported_results
from vergence.eval.article.twin.statistics import (
    AXES,
    METHODS,
    RankInPopulation,
    absolute_errors_mm,
    count_inside,
    depth_errors_percent,
    fixation_rows,
    rank_in_population,
    verdict,
)
from vergence.models.parts import FloatArray
from vergence.reporting.text import Numbers

NAME: Final = "physical static"
ARTICLE_SMALLEST_PERCENT: Final = {"gaze": 0.23, "itpc": 0.38}
"""The article's smallest depth errors, percent of depth."""
STILL_MM: Final = 1e-3
"""Scatter of fixes below which no encoder reading changed, mm (numerical)."""
_DIGITS: Final = 6
"""Decimals kept of errors in percent, to drop rounding errors (numerical)."""


def article_results(quantity: str) -> list[ReportedResult]:
    """The article's rows of this experiment."""
    return [r for r in reported_results() if (r.experiment, r.quantity) == (NAME, quantity)]


def population_ranks(
    table: pd.DataFrame, row: ReportedResult
) -> tuple[RankInPopulation, RankInPopulation]:
    """Placements of the article's least and greatest error in `row` among the heads'."""
    errors = absolute_errors_mm(fixation_rows(table), row.method, row.axis)
    least, greatest = row.span
    return rank_in_population(least, errors.min(axis=1)), rank_in_population(
        greatest, errors.max(axis=1)
    )


def summarise(table: pd.DataFrame, config: PhysicalStaticConfig) -> list[SummaryRow]:
    """Rows of the summary: the article's beside the median heads', then population and sources.

    Verdicts beyond those of `verdict_of_ranges`: `by construction` for the figure that set the
    error scale; `inside` or `outside` the middle 80 % of the heads; and for ITPC off the axis `ITPC
    worse` or `ITPC better` if its error differs from that of gaze by more than the margin, else
    `alike`.
    """
    return [
        *_reported_rows(table),
        *_population_rows(table),
        *_imaged_rows(table),
        *_method_rows(table),
        *_off_axis_rows(table, config),
        *_budget_rows(table),
    ]


def _reported_rows(table: pd.DataFrame) -> Iterator[SummaryRow]:
    for r in article_results("absolute error"):
        low, high = population_ranks(table, r)
        # the error scale was set by the largest depth error by gaze
        chosen = BY_CONSTRUCTION if (r.method, r.axis) == ("gaze", "z") else None
        yield SummaryRow.of(NAME, r.quantity, r.method, r.axis, r.span,
                            (low.median, high.median), chosen)  # fmt: skip
    for r in article_results("uncertainty"):
        ours = _range(fixation_rows(table, "imaged")[f"uncertainty_{r.axis}_mm"])
        yield SummaryRow.of(NAME, r.quantity, r.method, r.axis, r.span, ours)


def _population_rows(table: pd.DataFrame) -> Iterator[SummaryRow]:
    """Statistics of the population, 10th to 90th percentile of the heads."""
    population = fixation_rows(table)
    yield SummaryRow.of(NAME, "scale of all spreads", "both", "all", None,
                        float(_twin(table)["scale"]), unit="1")  # fmt: skip
    for method in METHODS:
        relative = depth_errors_percent(population, method)
        largest = rank_in_population(ARTICLE_LARGEST_PERCENT[method], relative.max(axis=1))
        smallest = rank_in_population(ARTICLE_SMALLEST_PERCENT[method], relative.min(axis=1))
        chosen = BY_CONSTRUCTION if method == "gaze" else verdict(largest)
        for quantity, placed, said in (
            ("largest depth error", largest, chosen),
            ("smallest depth error", smallest, verdict(smallest)),
        ):
            yield SummaryRow.of(NAME, f"{quantity}, middle 80 % of the heads", method, "z",
                                placed.article, (placed.low, placed.high), said, "%")  # fmt: skip
        for axis in AXES:
            low, high = np.percentile(
                absolute_errors_mm(population, method, axis).mean(axis=1), [10.0, 90.0]
            )
            yield SummaryRow.of(NAME, "mean absolute error", method, axis, None, (low, high))


def _imaged_rows(table: pd.DataFrame) -> Iterator[SummaryRow]:
    imaged = fixation_rows(table, "imaged")
    for method in METHODS:
        for axis in AXES:
            yield SummaryRow.of(NAME, "absolute error, head with images", method, axis, None,
                                _range(absolute_errors_mm(imaged, method, axis)))  # fmt: skip


def _method_rows(table: pd.DataFrame) -> Iterator[SummaryRow]:
    apart = _apart(table)
    yield SummaryRow.of(NAME, "gaze and ITPC apart in depth at settled fixations", "both", "z",
                        _article_apart_mm(),
                        (float(np.median(apart)), float(apart.max())))  # fmt: skip


def _off_axis_rows(table: pd.DataFrame, config: PhysicalStaticConfig) -> Iterator[SummaryRow]:
    whole = _off_axis(table, ALL)
    yield SummaryRow.of(NAME, "largest depth error off the axis, median head", "itpc", "z",
                        ARTICLE_LARGEST_PERCENT["itpc"], _range(whole["itpc_largest_percent"]),
                        unit="%")  # fmt: skip
    yield SummaryRow.of(NAME, "offset from which ITPC is worse than gaze, all errors", "both", "z",
                        None, crossover_px(whole, config.worse_margin), unit="px")  # fmt: skip
    for source in (ALL, *BUDGET_SOURCES):
        rows = _off_axis(table, source)
        last = rows.iloc[-1]
        yield SummaryRow.of(
            NAME,
            f"rms depth error of ITPC {last['offset_px']:g} px off the axis less that of gaze, "
            f"{_label(source)}",
            "both", "z", None, round(last["itpc_rms_percent"] - last["gaze_rms_percent"], _DIGITS),
            _off_axis_verdict(rows, config.worse_margin), "%",
        )  # fmt: skip


def _off_axis_verdict(rows: pd.DataFrame, margin: float) -> str:
    if np.isfinite(crossover_px(rows, margin)):
        return "ITPC worse"
    last = rows.iloc[-1]
    better = last["itpc_rms_percent"] < (1.0 - margin) * last["gaze_rms_percent"]
    return "ITPC better" if better else "alike"


def _budget_rows(table: pd.DataFrame) -> Iterator[SummaryRow]:
    """Depth errors from each source alone, over Table 5's points."""
    for source, rows in table[table["case"] == "budget"].groupby("source", sort=False):
        yield SummaryRow.of(NAME, f"rms depth error of a fixation, {_label(str(source))}", "both",
                            "z", None, _range(rows["rms_depth_error_percent"].round(_DIGITS)),
                            unit="%")  # fmt: skip


def _label(source: str) -> str:
    return "all errors" if source == ALL else SOURCE_LABELS.get(source, source)


def _range(values: FloatArray | pd.Series) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _twin(table: pd.DataFrame) -> pd.Series:
    return table[table["case"] == "twin"].iloc[0]


def _off_axis(table: pd.DataFrame, source: str) -> pd.DataFrame:
    """Rows of one source, from the axis outwards."""
    rows = table[(table["case"] == "off axis") & (table["source"] == source)]
    return rows.sort_values("offset_px")


def _apart(table: pd.DataFrame) -> FloatArray:
    """(heads * points,) absolute depth difference of gaze and ITPC at settled fixations, mm."""
    rows = fixation_rows(table).pivot(
        index=["head", "point"], columns="method", values="error_z_mm"
    )
    return np.asarray((rows["gaze"] - rows["itpc"]).abs().to_numpy(), dtype=np.float64)


def _article_apart_mm() -> float:
    """Difference of the article's largest depth errors, ITPC minus gaze, mm."""
    gaze, itpc = (reported_result(NAME, "absolute error", m, "z").span[1] for m in METHODS)
    return itpc - gaze


def numbers(table: pd.DataFrame, config: PhysicalStaticConfig) -> Numbers:
    """The numbers of the text."""
    largest = depth_errors_percent(fixation_rows(table), "gaze").max(axis=1)
    inside = [count_inside(population_ranks(table, r)) for r in article_results("absolute error")]
    apart, twin = _apart(table), _twin(table)
    return {
        "points_count": float(fixation_rows(table)["point"].nunique()),
        "scale_ratio": float(twin["scale"]),
        "largest_median_percent": float(np.median(largest)),
        "largest_high_percent": float(np.percentile(largest, 90.0)),
        "inside_count": sum(inside),
        "reported_count": 2 * len(inside),
        "apart_median_mm": float(np.median(apart)),
        "apart_most_mm": float(apart.max()),
        "article_apart_mm": _article_apart_mm(),
        "encoder_step_mm": float(twin["encoder_step_mm"]),
        "encoder_step_percent": float(twin["encoder_step_percent"]),
        **_off_axis_numbers(table, config),
        **_budget_numbers(table),
        **_imaged_numbers(table),
    }


def _off_axis_numbers(table: pd.DataFrame, config: PhysicalStaticConfig) -> Numbers:
    """Numbers on ITPC off the axis, at the largest and at the smallest non-zero offset."""
    whole, encoders = _off_axis(table, ALL), _off_axis(table, ENCODERS)
    beside = whole["offset_px"].to_numpy() > 0.0
    last, first = whole.iloc[-1], whole[beside].iloc[0]
    return {
        "margin_percent": 100.0 * config.worse_margin,
        "crossover_px": crossover_px(whole, config.worse_margin),
        "outermost_px": last["offset_px"],
        "outermost_itpc_percent": last["itpc_rms_percent"],
        "outermost_gaze_percent": last["gaze_rms_percent"],
        "outermost_worse_percent": 100.0 * last["worse_share"],
        "outermost_possible_percent": 100.0 * last["possible_share"],
        "innermost_px": first["offset_px"],
        "innermost_apart_percent": first["added_rms_percent"],
        "innermost_encoders_percent": encoders[beside].iloc[0]["added_rms_percent"],
        "itpc_largest_percent": float(whole["itpc_largest_percent"].max()),
        "excess_most_percent": 100.0 * float(whole["excess_share"].max()),
    }


def _budget_numbers(table: pd.DataFrame) -> Numbers:
    """Depth errors from each source alone at the nearest and at the farthest point."""
    rows = table[table["case"] == "budget"]
    wide = rows.pivot(index="truth_z_mm", columns="source", values="rms_depth_error_percent")
    return {"near_m": wide.index[0] / 1000.0, "far_m": wide.index[-1] / 1000.0} | {
        f"{where}_{source.replace(' ', '_')}_percent": float(wide[source].iloc[end])
        for where, end in (("near", 0), ("far", -1))
        for source in (ALL, ENCODERS, "head_eye_rad", "principal_px", "joint_offset_rad")
    }


def _imaged_numbers(table: pd.DataFrame) -> Numbers:
    """Numbers on the head with images: errors, detection noise and propagated uncertainty."""
    imaged, population = fixation_rows(table, "imaged"), fixation_rows(table)
    far = imaged.sort_values("uncertainty_z_mm").iloc[-1]
    article = reported_result(NAME, "uncertainty", "both", "z").span[1]
    ratio = float(far["uncertainty_z_mm"]) / article
    still = {
        name: rows.loc[rows["method"] == "gaze", "scatter_z_mm"] <= STILL_MM
        for name, rows in (("imaged", imaged), ("population", population))
    }
    uncertainty = {axis: _range(imaged[f"uncertainty_{axis}_mm"]) for axis in AXES}
    return {
        "imaged_head": float(imaged["head"].iloc[0]),
        "imaged_largest_percent": float(depth_errors_percent(imaged, "gaze").max()),
        "sigma_least_px": float(imaged["sigma_least_px"].min()),
        "sigma_greatest_px": float(imaged["sigma_greatest_px"].max()),
        **{f"uncertainty_{axis}_least_mm": low for axis, (low, _) in uncertainty.items()},
        **{f"uncertainty_{axis}_greatest_mm": high for axis, (_, high) in uncertainty.items()},
        "uncertainty_ratio": ratio,
        "article_sigma_px": float(far["sigma_rms_px"]) / ratio,
        "still_count": float(still["imaged"].sum()),
        "imaged_count": float(len(still["imaged"])),
        "still_percent": 100.0 * float(still["population"].mean()),
    }
