"""Statistics of a controller's trials, with bootstrap intervals that a seed reproduces.

No trial is dropped. A trial that never settles counts with its duration in medians and percentiles
of times, and as infinite in those of ratios to the bound; a trial that swings never settles. A
missing gaze fix counts as an infinite error.

Trials are resampled with replacement, a thousand times. The random generator depends only on the
seed and the number of trials, so two controllers that ran the same trials get the same resamples.
The interval of their ratio is therefore a paired one: the difficulty of a trial common to both
cancels.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from vergence.eval.comparison.contestants import BOUND
from vergence.eval.trials.settling import (
    HALF_PX,
    ONE_PX,
    SettlingBand,
    bands_with_bound,
    bands_with_settle_time,
)
from vergence.models.parts import FloatArray

RESAMPLES: Final = 1000
"""Bootstrap resamples of an interval (chosen: precision of its ends against time)."""
LEVEL: Final = 0.95
"""Confidence level: fraction of such intervals that hold the value of the whole population of
trials (chosen)."""
_MOST_BLOCK_VALUES: Final = 2_000_000
"""Most values resampled at once, a bound on memory (numerical)."""

Statistic = Callable[[FloatArray], FloatArray]
"""Function from (..., n) values to (...), over the last axis."""


class ConfidenceInterval(NamedTuple):
    """A statistic and its confidence interval at the level `LEVEL`."""

    value: float
    low: float
    high: float


def median(values: FloatArray) -> FloatArray:
    """The median over the last axis."""
    return np.asarray(np.median(values, axis=-1))


def mean(values: FloatArray) -> FloatArray:
    """The mean over the last axis; for booleans, the fraction that is true."""
    return np.asarray(np.mean(values, axis=-1))


def percentile(values: FloatArray, percent: float) -> FloatArray:
    """A percentile over the last axis: the higher of the two nearest values, not interpolated.

    Interpolation is undefined between infinite values.
    """
    return np.asarray(np.percentile(values, percent, axis=-1, method="higher"))


p95: Final[Statistic] = partial(percentile, percent=95.0)


class Bootstrap:
    """Intervals for statistics of `num` trials."""

    def __init__(self, num: int, seed: int = 0, resamples: int = RESAMPLES) -> None:
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, num])))
        rows = max(1, _MOST_BLOCK_VALUES // num)
        self._blocks: list[NDArray[np.int32]] = [
            rng.integers(num, size=(min(rows, resamples - begin), num), dtype=np.int32)
            for begin in range(0, resamples, rows)
        ]

    def interval(self, values: ArrayLike, statistic: Statistic) -> ConfidenceInterval:
        """A statistic of (n,) values, one per trial, with its percentile interval."""
        array = np.asarray(values)
        if (array == array[0]).all():  # nothing to resample
            value = float(statistic(array))
            if array.dtype == np.bool_:
                return _unanimous(value, len(array))
            return ConfidenceInterval(value, value, value)
        return _interval(float(statistic(array)), self._resampled(array, statistic))

    def ratio(
        self, numerator: ArrayLike, denominator: ArrayLike, statistic: Statistic
    ) -> ConfidenceInterval:
        """The ratio of a statistic of two controllers on the same trials; its paired interval."""
        top, bottom = np.asarray(numerator), np.asarray(denominator)
        drawn = self._resampled(top, statistic) / self._resampled(bottom, statistic)
        return _interval(float(statistic(top) / statistic(bottom)), drawn)

    def _resampled(self, values: NDArray[Any], statistic: Statistic) -> FloatArray:
        return np.concatenate([statistic(values[block]) for block in self._blocks])


def _unanimous(value: float, num: int) -> ConfidenceInterval:
    """The exact (Clopper-Pearson) interval of a fraction that is 0 or 1."""
    far = (0.5 * (1.0 - LEVEL)) ** (1.0 / num)
    return (
        ConfidenceInterval(value, far, 1.0)
        if value == 1.0
        else ConfidenceInterval(value, 0.0, 1.0 - far)
    )


def _interval(value: float, drawn: FloatArray) -> ConfidenceInterval:
    tail = 50.0 * (1.0 - LEVEL)
    low, high = np.percentile(drawn, [tail, 100.0 - tail], method="nearest")
    return ConfidenceInterval(value, float(low), float(high))


_UNDEFINED: Final = ConfidenceInterval(np.nan, np.nan, np.nan)

SWINGING: Final = "swinging_trials"
"""Column with the number of trials that swing; `swings_fraction` is their fraction, with its
interval."""
_SETTLING_STATISTICS: Final[dict[str, tuple[str, Statistic]]] = {
    "overshoot_median": ("overshoot", median),
    "overshoot_p95": ("overshoot", p95),
    "residual_px": ("residual_px", median),
    "residual_p95_px": ("residual_px", p95),
    "fix_error_settled_median_m": ("fix_error_settled_m", median),
    "left_again_fraction": ("left_again", mean),
    "swings_fraction": ("swings", mean),
    "fixation_rms_median_rad_s": ("fixation_rms_rad_s", median),
    "fixation_peak_to_peak_median_rad_s": ("fixation_peak_to_peak_rad_s", median),
    "fixation_peak_to_peak_p95_rad_s": ("fixation_peak_to_peak_rad_s", p95),
}
_TRACKING_STATISTICS: Final[dict[str, tuple[str, Statistic]]] = {
    "tracking_rms_px": ("tracking_px", median),
    "tracking_rms_p95_px": ("tracking_px", p95),
    "tracking_lag_median_s": ("tracking_lag_s", median),
}
_COMMON_STATISTICS: Final[dict[str, tuple[str, Statistic]]] = {
    "steady_median_px": ("steady_px", median),
    "steady_p95_px": ("steady_px", p95),
    "lost_fraction": ("lost", mean),
    "energy_median_rad2_s": ("energy_rad2_s", median),
    "peak_median_rad_s": ("peak_rad_s", median),
    "fix_error_end_median_m": ("fix_error_end_m", median),
    "fix_error_end_p95_m": ("fix_error_end_m", p95),
}


def _of_bands(band_px: float) -> dict[str, tuple[str, Statistic]]:
    """Statistics (column and function by name) of a scenario's bands, widest first."""
    found: dict[str, tuple[str, Statistic]] = {}
    for band in reversed(bands_with_bound(band_px)):
        found[band.settled_fraction_column] = (band.settled_column, mean)
        for one in (ONE_PX, HALF_PX) if band == ONE_PX else (band,):
            found[one.settle_median_s_column] = (one.settle_s_column, median)
            found[one.settle_p95_s_column] = (one.settle_s_column, p95)
        found[band.ratio_median_column] = (band.ratio_column, median)
        found[band.ratio_p95_column] = (band.ratio_column, p95)
    return found


def imputed_trial_values(table: pd.DataFrame, band_px: float) -> dict[str, FloatArray]:
    """Columns of a controller's trials as arrays in which missing values are imputed.

    A missing settle time becomes the trial's duration; a missing ratio to the bound, or a missing
    fix, infinity. Columns for settling and for the ratio are added.
    """
    duration = table["duration_s"].to_numpy()
    values: dict[str, Any] = {
        name: table[name].to_numpy() for name in table.columns if table[name].dtype != object
    }
    for band in bands_with_bound(band_px):
        settle, bound = values[band.settle_s_column], values[band.bound_s_column]
        values[band.settled_column] = np.isfinite(settle)
        # the ratio counts as infinite if the trial never settled, or if it is too short even for
        # the bound
        never = (bound >= duration) | np.isnan(settle)
        ratio = settle / np.where(bound > 0.0, bound, np.nan)
        values[band.ratio_column] = np.where(never & ~np.isnan(bound), np.inf, ratio)
    for band in bands_with_settle_time(band_px):
        settle = values[band.settle_s_column]
        values[band.settle_s_column] = np.where(np.isnan(settle), duration, settle)
    # a trial that never settles has its last gaze fix in place of the one at settling
    settled = values["fix_error_settled_m"]
    end = values["fix_error_end_m"]
    known = np.isfinite(end).any()  # without ground truth there is no fix error at all
    end = np.where(np.isnan(end) & known, np.inf, end)
    values["fix_error_end_m"] = end
    values["fix_error_settled_m"] = np.where(np.isnan(settled), end, settled)
    return values


def trial_statistics(
    table: pd.DataFrame, target_moves: bool, duration_s: float, band_px: float, seed: int
) -> dict[str, Any]:
    """All statistics of one controller's trials, nan if undefined.

    The ends of the interval of each have the suffixes `_low` and `_high`.
    """
    bootstrap = Bootstrap(len(table), seed)
    values = imputed_trial_values(table, band_px)
    row: dict[str, Any] = {"trials": len(table), "duration_s": duration_s}
    row[SWINGING] = np.nan if target_moves else int(values["swings"].sum())
    settling = {**_of_bands(band_px), **_SETTLING_STATISTICS}
    has = {**(_TRACKING_STATISTICS if target_moves else settling), **_COMMON_STATISTICS}
    for name, (column, statistic) in {
        **settling,
        **_TRACKING_STATISTICS,
        **_COMMON_STATISTICS,
    }.items():
        found = _UNDEFINED
        if name in has and not np.isnan(values[column]).any():
            found = bootstrap.interval(values[column], statistic)
        _put(row, name, found)
    return row


def speed_up(
    table: pd.DataFrame, reference: pd.DataFrame, target_moves: bool, band_px: float, seed: int
) -> dict[str, float]:
    """Speed-up over another controller on the same trials: `faster` with the ends of its interval.

    It is the ratio of the other's median settle time to the band, or tracking RMS if the target
    moves, to this one's; nan if no more than half of the trials of either controller have settled,
    as the median is undefined then.
    """
    column = "tracking_px" if target_moves else SettlingBand(band_px).settle_s_column
    ours, theirs = (imputed_trial_values(one, band_px)[column] for one in (table, reference))
    settled = (
        target_moves or min(np.isfinite(one[column]).mean() for one in (table, reference)) > 0.5
    )
    row: dict[str, float] = {}
    found = _UNDEFINED
    if settled:
        with np.errstate(divide="ignore", invalid="ignore"):
            found = Bootstrap(len(ours), seed).ratio(theirs, ours, median)
    _put(row, "faster", found)
    return row


def bound_trials(tables: Sequence[pd.DataFrame], band_px: float) -> pd.DataFrame:
    """Trials of the bound: the least bound of any controller's trial for each target.

    In simulation all controllers have the same bounds. On a robot each trial has its own, as its
    images arrive at other times.
    """
    least = {
        band.bound_s_column: np.fmin.reduce([one[band.bound_s_column].to_numpy() for one in tables])
        for band in bands_with_bound(band_px)
    }
    return tables[0].assign(**least)


def bound_summary(table: pd.DataFrame, band_px: float, seed: int) -> dict[str, Any]:
    """The row of the time-optimal bound over `bound_trials`; nan for what a bound does not have."""
    limit = imputed_trial_values(table, band_px)
    bootstrap = Bootstrap(len(table), seed)
    row: dict[str, Any] = {name: table[name].iloc[0] for name in ("scenario", "plant")}
    row |= {"controller": BOUND, "options": {}, "trials": len(table)}
    row["duration_s"] = float(table["duration_s"].iloc[0])
    one = ConfidenceInterval(1.0, 1.0, 1.0)
    found = dict.fromkeys(
        [*_of_bands(band_px), *_SETTLING_STATISTICS, *_TRACKING_STATISTICS, *_COMMON_STATISTICS],
        _UNDEFINED,
    )
    for band in bands_with_bound(band_px):
        bound = limit[band.bound_s_column]
        within = np.minimum(bound, limit["duration_s"])
        found[band.settled_fraction_column] = bootstrap.interval(bound < limit["duration_s"], mean)
        found[band.settle_median_s_column] = bootstrap.interval(within, median)
        found[band.settle_p95_s_column] = bootstrap.interval(within, p95)
        found[band.ratio_median_column] = found[band.ratio_p95_column] = one
    for name, interval in found.items():
        _put(row, name, interval)
    row["predict_us"] = row["predict_one_us"] = row[SWINGING] = np.nan
    return row


def _put(row: dict[str, Any], name: str, interval: ConfidenceInterval) -> None:
    row[name], row[f"{name}_low"], row[f"{name}_high"] = interval
