"""Results of the comparison with a fixed pair: summary rows, and the numbers of the text."""

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from vergence.eval.article.experiment import SummaryRow
from vergence.eval.article.fixed_pair.trials import FixedPairConfig
from vergence.eval.article.reported import ReportedResult, reported_results, static_points
from vergence.eval.article.twin.statistics import (
    AXES,
    METHODS,
    RankInPopulation,
    count_inside,
    rank_in_population,
)
from vergence.models.parts import FloatArray
from vergence.reporting.text import Numbers

NAME: Final = "versus ZED Mini"
_BASELINE_M: Final = 0.092
"""Baseline of the head's eyes, m (physical: the article's head)."""


def article_results() -> list[ReportedResult]:
    """The article's rows of this experiment."""
    return [r for r in reported_results() if r.experiment == NAME]


def fix_errors_mm(table: pd.DataFrame, method: str, axis: str) -> FloatArray:
    """(draws, points) errors against the truth, mm."""
    rows = table[(table["case"] == "fix") & (table["method"] == method)]
    wide = rows.pivot(index="draw", columns="point", values=f"error_{axis}_mm")
    return np.asarray(wide.to_numpy(), dtype=np.float64)


def absolute_differences_mm(table: pd.DataFrame, method: str, axis: str, pair: str) -> FloatArray:
    """(draws, points) absolute differences of head and pair, mm; `both` joins both methods."""
    methods = METHODS if method == "both" else (method,)
    other = fix_errors_mm(table, pair, axis)
    return np.concatenate([np.abs(fix_errors_mm(table, m, axis) - other) for m in methods], axis=1)


def population_ranks(
    table: pd.DataFrame, r: ReportedResult, pair: str
) -> tuple[RankInPopulation, RankInPopulation]:
    """Placements of the article's least and greatest difference among ours."""
    apart = absolute_differences_mm(table, r.method, r.axis, pair)
    least, greatest = r.span
    return rank_in_population(least, apart.min(axis=1)), rank_in_population(
        greatest, apart.max(axis=1)
    )


class Misalignment(NamedTuple):
    """Error of the pair's pose in N that would explain a range of differences along x or y."""

    low_mm: float
    high_mm: float
    rotation_deg: float
    """Best fit by a rotation alone: yaw for x, pitch for y."""
    rotation_low_mm: float
    rotation_high_mm: float
    """Range of differences under that rotation."""
    rotation_with_shift_deg: float
    """Rotation that, with `shift_mm`, gives the range exactly."""
    shift_mm: float

    @property
    def misfit_mm(self) -> float:
        """Largest difference between an end of the article's range and of the rotation's."""
        return max(
            abs(self.rotation_low_mm - self.low_mm), abs(self.rotation_high_mm - self.high_mm)
        )


def explaining_misalignment(r: ReportedResult, pair_z_mm: float) -> Misalignment:
    """Misalignment that explains a range if heads and pair have no other errors.

    A rotation by a small angle t shifts a point at distance z by t z, so differences grow with
    depth. The least difference is taken to belong to the nearest point, the greatest to the
    farthest.

    Args:
        r: a row of the article along x or y.
        pair_z_mm: z of the pair in N.

    Returns:
        The misalignment.
    """
    low, high = r.span
    depth = 1000.0 * static_points("zed_mini")[:, 2] - pair_z_mm
    near, far = float(depth.min()), float(depth.max())
    turn = (near * low + far * high) / (near**2 + far**2)
    slope = (high - low) / (far - near)
    return Misalignment(
        low, high, float(np.rad2deg(turn)), turn * near, turn * far,
        float(np.rad2deg(slope)), low - slope * near,
    )  # fmt: skip


def explaining_misalignments(config: FixedPairConfig) -> dict[str, Misalignment]:
    """Misalignments that explain the article's ranges along x and y, by axis."""
    return {
        r.axis: explaining_misalignment(r, config.pair_place_mm[2])
        for r in article_results()
        if r.axis in ("x", "y")
    }


def summarise(table: pd.DataFrame, config: FixedPairConfig) -> list[SummaryRow]:
    """Rows of the summary: medians over the draws of the least and the greatest difference.

    Verdicts beyond those of `verdict_of_ranges`: `head nearer` or `pair nearer` to the ground
    truth; `agrees` if a rotation of the pair alone gives the article's range within a tenth of its
    upper end, else `differs`.
    """
    return [
        *_difference_rows(table),
        *_error_rows(table),
        *_turn_rows(config),
    ]


def _difference_rows(table: pd.DataFrame) -> Iterator[SummaryRow]:
    for quantity, pair in (
        ("absolute difference", "pair"),
        ("absolute difference, pair's pose unknown", "misaligned"),
    ):
        for r in article_results():
            low, high = population_ranks(table, r, pair)
            yield SummaryRow.of(NAME, quantity, r.method, r.axis, r.span,
                                (low.median, high.median))  # fmt: skip


def _error_rows(table: pd.DataFrame) -> Iterator[SummaryRow]:
    for method in ("gaze", "itpc", "pair"):
        for axis in AXES:
            low, high = np.percentile(_means(table, method, axis), [10.0, 90.0])
            yield SummaryRow.of(NAME, "mean absolute error", method, axis, None, (low, high))
    ratio = _depth_ratio(table)
    nearer = "pair nearer" if ratio > 1.0 else "head nearer"
    yield SummaryRow.of(NAME, "mean absolute error, median head over median pair", "gaze", "z",
                        None, ratio, nearer, "1")  # fmt: skip


def _turn_rows(config: FixedPairConfig) -> Iterator[SummaryRow]:
    for axis, m in explaining_misalignments(config).items():
        yield SummaryRow.of(
            NAME, "absolute difference, by a turn of the pair alone", "both", axis,
            (m.low_mm, m.high_mm), (m.rotation_low_mm, m.rotation_high_mm),
            "agrees" if m.misfit_mm < 0.1 * m.high_mm else "differs",
        )  # fmt: skip


def _means(table: pd.DataFrame, method: str, axis: str) -> FloatArray:
    """(draws,) mean absolute errors over the points, mm."""
    return np.asarray(np.abs(fix_errors_mm(table, method, axis)).mean(axis=1))


def _depth_ratio(table: pd.DataFrame) -> float:
    """Ratio of the median head's mean depth error to the median pair's."""
    gaze, pair = (float(np.median(_means(table, m, "z"))) for m in ("gaze", "pair"))
    return gaze / pair


def numbers(table: pd.DataFrame, config: FixedPairConfig) -> Numbers:
    """The numbers of the text."""
    detector = table.loc[table["case"] == "detector", "sigma_px"]
    gaze, itpc, pair = (fix_errors_mm(table, method, "z") for method in ("gaze", "itpc", "pair"))
    inside = {
        pair: [count_inside(population_ranks(table, r, pair)) for r in article_results()]
        for pair in ("pair", "misaligned")
    }
    most_m = max(r.span[1] for r in article_results() if r.axis == "z") / 1000.0
    far_m = float(static_points("zed_mini")[:, 2].max())
    # the rotation between the cameras is the difference of two independent rotations
    rotation = np.sqrt(2.0) * config.calibration.head_eye_rad
    values = {
        f"{method}_{axis}_mm": float(np.median(_means(table, method, axis)))
        for method in ("gaze", "pair")
        for axis in AXES
    } | {
        "sigma_least_px": float(detector.min()),
        "sigma_greatest_px": float(detector.max()),
        "depth_ratio": _depth_ratio(table),
        "closer_percent": 100.0 * float(np.mean(np.abs(gaze) < np.abs(pair))),
        "calibration_rotation_deg": float(np.rad2deg(rotation)),
        "inside_known_count": sum(inside["pair"]),
        "inside_unknown_count": sum(inside["misaligned"]),
        "reported_count": 2 * len(inside["pair"]),
        "far_m": far_m,
        "vergence_deg": float(np.rad2deg(most_m * _BASELINE_M / far_m**2)),
        "nearer_percent": 100.0 * float(np.mean(np.abs(gaze - pair) < np.abs(itpc - pair))),
        "apart_median_mm": float(np.median(np.abs(gaze - itpc))),
    }
    for axis, m in explaining_misalignments(config).items():
        values |= {
            f"turn_{axis}_deg": m.rotation_deg,
            f"turn_{axis}_least_mm": m.rotation_low_mm,
            f"turn_{axis}_greatest_mm": m.rotation_high_mm,
            f"both_{axis}_deg": m.rotation_with_shift_deg,
            f"shift_{axis}_mm": m.shift_mm,
        }
    return values
