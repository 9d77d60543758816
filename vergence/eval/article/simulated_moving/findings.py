"""Results of the moving target on the simulated rig, beside the article's figures."""

from dataclasses import dataclass
from math import hypot, pi
from typing import Final

import pandas as pd

from vergence.eval.article.common.loop_noise import LinearLoop, noise_gain
from vergence.eval.article.common.simulated_cases import CASES
from vergence.eval.article.experiment import SummaryRow
from vergence.eval.article.reported import reported_result, reported_results
from vergence.eval.article.simulated_moving.trials import (
    IMAGES,
    NONE,
    WHITE,
    SimulatedMovingConfig,
)
from vergence.models.head_file import load_head
from vergence.reporting.text import Numbers

EXPERIMENT: Final = "simulated moving"
"""Name of this experiment in the table of the article's results."""
ARTICLE_CASE: Final = "principal"
"""Case that represents the article's rig: Table 2's camera matrix on a centred image."""
RATES_HZ: Final = (120.0, 60.0, 30.0, 20.0, 15.0)
"""Frame rates at which the loop's noise gain is predicted, Hz (chosen)."""


def article_value_mm(quantity: str, method: str, axis: str) -> float:
    """A value that the article reports, mm."""
    return reported_result(EXPERIMENT, quantity, method, axis).low


def select_samples(
    table: pd.DataFrame, case: str, method: str, noise: str = IMAGES
) -> pd.DataFrame:
    """The samples of one case and method, in order."""
    chosen = (table["case"] == case) & (table["method"] == method) & (table["noise"] == noise)
    return table[chosen]


@dataclass(frozen=True, kw_only=True)
class SampleErrors:
    """Errors of one case and method over the samples, by axis, mm."""

    mean_absolute: dict[str, float]
    mean: dict[str, float]
    standard_deviation: dict[str, float]

    @staticmethod
    def of(samples: pd.DataFrame) -> "SampleErrors":
        """The errors of some samples."""
        columns = {axis: samples[f"error_{axis}_mm"] for axis in "xyz"}
        return SampleErrors(
            mean_absolute={axis: float(column.abs().mean()) for axis, column in columns.items()},
            mean={axis: float(column.mean()) for axis, column in columns.items()},
            standard_deviation={axis: float(column.std()) for axis, column in columns.items()},
        )

    @property
    def plane_mm(self) -> float:
        """Root mean square distance from the target in the circle's plane, mm."""
        square = (self.standard_deviation[axis] ** 2 + self.mean[axis] ** 2 for axis in "xy")
        return float(sum(square) ** 0.5)


Cases = dict[tuple[str, str, str], SampleErrors]
"""Errors by case, method and noise."""


def errors_by_case(table: pd.DataFrame) -> Cases:
    """The errors of all cases of a table."""
    return {
        (str(case), str(method), str(noise)): SampleErrors.of(samples)
        for (case, method, noise), samples in table.groupby(["case", "method", "noise"])
    }


def deviation_ratio(errors: Cases, case: str, noise: str = IMAGES) -> float:
    """Ratio of the standard deviations in z, gaze over ITPC."""
    gaze, itpc = errors[case, "gaze", noise], errors[case, "itpc", noise]
    return gaze.standard_deviation["z"] / itpc.standard_deviation["z"]


def article_deviation_ratio() -> float:
    """Ratio of the article's standard deviations in z, gaze over ITPC."""
    gaze, itpc = (
        article_value_mm("standard deviation", method, "z") for method in ("gaze", "itpc")
    )
    return gaze / itpc


def predicted_deviation_ratios(gain: float) -> dict[float, float]:
    """Ratio of scatter, gaze over ITPC, predicted from the loop's noise gain, by frame rate."""
    loop = LinearLoop.of(load_head("simulated"), gain)
    return {rate: noise_gain(loop.at_rate(rate)) for rate in RATES_HZ}


def expected_gaze_deviation_mm(errors: Cases, case: str, share: float) -> float:
    """Standard deviation in z expected of gaze, given the article's ITPC, mm.

    Gaze has the systematic part of a case, plus the fraction `share` of ITPC's scatter that the
    loop lets through.
    """
    systematic = errors[case, "gaze", NONE].standard_deviation["z"]
    itpc = article_value_mm("standard deviation", "itpc", "z")
    return hypot(systematic, share * max(itpc**2 - systematic**2, 0.0) ** 0.5)


def numbers(table: pd.DataFrame, config: SimulatedMovingConfig) -> Numbers:
    """The numbers of the text."""
    errors = errors_by_case(table)
    timing = load_head("simulated").timing
    speed = 2.0 * pi * config.radius_mm / config.period_s
    still, undated = errors["exact", "gaze", NONE], errors["exact", "itpc, undated", IMAGES]
    found = {
        "period_ms": 1000.0 * timing.period_s,
        "turn_percent": 100.0 * config.samples * config.every * timing.period_s / config.period_s,
        "speed_mm_s": speed,
        "trail_mm": still.plane_mm,
        "speed_over_gain_mm": speed / config.gain,
        "latency_way_mm": speed * timing.latency_s,
        "undated_plane_mm": undated.plane_mm,
        "ratio_exact": deviation_ratio(errors, "exact"),
        "ratio_white": deviation_ratio(errors, "exact", WHITE),
        "principal_systematic_z_mm": errors[ARTICLE_CASE, "gaze", NONE].standard_deviation["z"],
    }
    found |= {f"still_{axis}_mm": still.mean_absolute[axis] for axis in "xyz"}
    for method in ("gaze", "itpc"):
        for axis in "xyz":
            key, article = (
                f"{method}_{axis}_mm",
                article_value_mm("mean absolute error", method, axis),
            )
            found[f"article_{key}"] = article
            for case in ("exact", ARTICLE_CASE):
                found[f"{case}_{key}"] = errors[case, method, IMAGES].mean_absolute[axis]
        found[f"article_{method}_scatter_mm"] = article_value_mm("standard deviation", method, "z")
        found[f"exact_{method}_scatter_mm"] = errors["exact", method, IMAGES].standard_deviation[
            "z"
        ]
    for rate, share in predicted_deviation_ratios(config.gain).items():
        found[f"ratio_predicted_{rate:g}_hz"] = share
        for case in ("exact", ARTICLE_CASE):
            found[f"expected_{case}_{rate:g}_hz_mm"] = expected_gaze_deviation_mm(
                errors, case, share
            )
    return found


def summarise(table: pd.DataFrame, config: SimulatedMovingConfig) -> list[SummaryRow]:
    """Rows of the summary: the article's under its own camera matrix, then those of other cases.

    Verdicts beyond those of `verdict_of_ranges`: `target met` if the optical axes trail the target
    by its speed over the gain, else `target missed`.
    """
    errors = errors_by_case(table)
    rows = []
    for case in (ARTICLE_CASE, *(case for case in CASES if case != ARTICLE_CASE)):
        suffix = "" if case == ARTICLE_CASE else f", {CASES[case].title}"
        for row in reported_results():
            if row.experiment == EXPERIMENT:
                own = errors[case, row.method, IMAGES]
                scatter = row.quantity == "standard deviation"
                value = (own.standard_deviation if scatter else own.mean_absolute)[row.axis]
                rows.append(_row(row.quantity + suffix, row.method, row.axis, value, row.low))
    for axis in "xyz":
        for quantity, method, noise in (
            ("mean absolute error, exact model, no noise", "gaze", NONE),
            ("mean absolute error, exact model", "itpc, undated", IMAGES),
        ):
            rows.append(
                _row(quantity, method, axis, errors["exact", method, noise].mean_absolute[axis])
            )
    for case in CASES:
        quantity = f"standard deviation, {CASES[case].title}, no noise"
        rows.append(_row(quantity, "gaze", "z", errors[case, "gaze", NONE].standard_deviation["z"]))
    predicted = predicted_deviation_ratios(config.gain)
    measured = {CASES[case].title: deviation_ratio(errors, case) for case in CASES}
    measured["exact model, white noise"] = deviation_ratio(errors, "exact", WHITE)
    measured |= {f"predicted at {rate:g} Hz": share for rate, share in predicted.items()}
    for title, value in measured.items():
        quantity = f"standard deviation, gaze over ITPC, {title}"
        rows.append(_row(quantity, "both", "z", value, article_deviation_ratio(), "1"))
    for case in ("exact", ARTICLE_CASE):
        for rate, share in predicted.items():
            quantity = (
                f"standard deviation expected beside the article's ITPC, {CASES[case].title}, "
                f"{rate:g} Hz"
            )
            value = expected_gaze_deviation_mm(errors, case, share)
            rows.append(
                _row(
                    quantity,
                    "gaze",
                    "z",
                    value,
                    article_value_mm("standard deviation", "gaze", "z"),
                )
            )
    return [*rows, _trail(numbers(table, config))]


def _trail(found: Numbers) -> SummaryRow:
    """Summary row on the distance by which the optical axes trail: expected is speed over gain."""
    wanted, trail = found["speed_over_gain_mm"], found["trail_mm"]
    verdict = "target met" if abs(trail - wanted) < 0.1 * wanted else "target missed"
    quantity = f"way behind the target, exact model, no noise, target {wanted:.3g} mm within 10 %"
    return SummaryRow.of(EXPERIMENT, quantity, "gaze", "x, y", None, trail, verdict)


def _row(
    quantity: str, method: str, axis: str, value: float, article: float | None = None,
    unit: str = "mm",
) -> SummaryRow:  # fmt: skip
    return SummaryRow.of(EXPERIMENT, quantity, method, axis, article, value, unit=unit)
