"""Results of the moving target on the physical twin: summary rows, and the numbers of the text."""

from typing import Final

import numpy as np
import pandas as pd

from vergence.eval.article.experiment import SummaryRow
from vergence.eval.article.physical_moving.trials import PhysicalMovingConfig
from vergence.eval.article.reported import ReportedResult, reported_result
from vergence.eval.article.twin.statistics import (
    AXES,
    METHODS,
    RankInPopulation,
    count_inside,
    rank_in_population,
    verdict,
)
from vergence.models.parts import FloatArray
from vergence.reporting.text import Numbers

NAME: Final = "physical moving"
_MIDDLE: Final = ", middle 80 % of the heads"
_GAIN: Final = 4.0
"""Gain of the control law, 1/s (physical: a setting of the article's system)."""
_FARTHEST_STATIC_M: Final = 2.5
"""Depth of the farthest static point, m (physical: the article's Table 5)."""


def article_result(method: str, axis: str) -> ReportedResult:
    """The article's mean absolute error of a method and axis."""
    return reported_result(NAME, "mean absolute error", method, axis)


def column_by_head(table: pd.DataFrame, group: str, method: str, column: str) -> FloatArray:
    """(heads,) one column of the table, by head."""
    rows = table[
        (table["case"] == "head") & (table["group"] == group) & (table["method"] == method)
    ]
    return np.asarray(rows.sort_values("head")[column].to_numpy(), dtype=np.float64)


def population_rank(
    table: pd.DataFrame, method: str, axis: str, group: str = "population"
) -> RankInPopulation:
    """Placement of the article's mean absolute error among the heads'."""
    ours = column_by_head(table, group, method, f"mean_abs_{axis}_mm")
    return rank_in_population(article_result(method, axis).low, ours)


def summarise(table: pd.DataFrame, config: PhysicalMovingConfig) -> list[SummaryRow]:
    """Rows of the summary: median and middle 80 % of the heads, and the head with images."""
    del config
    rows = []
    for axis in AXES:
        for method in METHODS:
            placed, quantity = population_rank(table, method, axis), "mean absolute error"
            rows.append(SummaryRow.of(NAME, quantity, method, axis, placed.article, placed.median))
            rows.append(_row(f"{quantity}{_MIDDLE}", method, axis, placed))
            seen = float(column_by_head(table, "imaged", method, f"mean_abs_{axis}_mm")[0])
            rows.append(
                SummaryRow.of(NAME, "mean absolute error, head with images", method, axis, None,
                              seen)
            )  # fmt: skip
        rows.append(
            _row(f"mean absolute error, gaze less ITPC{_MIDDLE}", "both", axis, _apart(table, axis))
        )
    for method in METHODS:
        placed = population_rank(table, method, "y", "half tilt")
        rows.append(
            _row(f"mean absolute error, half the common tilt{_MIDDLE}", method, "y", placed)
        )
    return rows


def _row(quantity: str, method: str, axis: str, placed: RankInPopulation) -> SummaryRow:
    return SummaryRow.of(NAME, quantity, method, axis, placed.article, (placed.low, placed.high),
                         verdict(placed))  # fmt: skip


def _apart(table: pd.DataFrame, axis: str) -> RankInPopulation:
    """Placement of the article's difference between the methods among the heads'."""
    gaze, itpc = (column_by_head(table, "population", m, f"mean_abs_{axis}_mm") for m in METHODS)
    article = round(article_result("gaze", axis).low - article_result("itpc", axis).low, 2)
    return rank_in_population(article, gaze - itpc)


def numbers(table: pd.DataFrame, config: PhysicalMovingConfig) -> Numbers:
    """The numbers of the text."""
    twin = table[table["case"] == "twin"].iloc[0]
    x_mm, _, z_mm = config.middle_mm
    tilt = max(article_result(method, "y").low for method in METHODS) / z_mm
    values = {
        "scale_ratio": float(twin["scale"]),
        "inside_count": count_inside([population_rank(table, m, a) for m in METHODS for a in AXES]),
        # the error in x that follows from the depth error along the line of sight
        "along_sight_mm": abs(x_mm / z_mm) * article_result("gaze", "z").low,
        "article_tilt_deg": float(np.rad2deg(tilt)),
        "article_tilt_far_mm": 1000.0 * tilt * _FARTHEST_STATIC_M,
        "middle_m": z_mm / 1000.0,
        "assumed_tilt_deg": float(np.rad2deg(config.errors.common_tilt_rad)),
        "common_tilt_deg": twin["scale"] * float(np.rad2deg(config.errors.common_tilt_rad)),
        "imaged_head": float(twin["head"]),
    }
    for method in METHODS:
        placed = population_rank(table, method, "y", "half tilt")
        values |= {f"half_{method}_low_mm": placed.low, f"half_{method}_high_mm": placed.high}
    for axis, velocity in zip(AXES, config.velocity_mm_s, strict=True):
        gaze, itpc = (column_by_head(table, "population", m, f"mean_{axis}_mm") for m in METHODS)
        apart = _apart(table, axis)
        values |= {
            f"trail_{axis}_mm": float(np.median(gaze - itpc)),
            f"lag_{axis}_mm": -velocity / _GAIN,
            f"apart_{axis}_low_mm": apart.low,
            f"apart_{axis}_high_mm": apart.high,
        }
        for method in METHODS:
            own = column_by_head(table, "imaged", method, f"mean_abs_{axis}_mm")
            values[f"imaged_{method}_{axis}_mm"] = float(own[0])
    return values
