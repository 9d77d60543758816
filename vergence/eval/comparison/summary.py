"""What a controller's trials come to: each statistic with its interval.

A trial that never settles counts as the whole trial in every median and percentile of times, and
as infinitely far from the bound in those of ratios; a gaze fix that has no answer counts as
infinitely far off. Nothing is dropped.
"""

from typing import Any, Final

import numpy as np
import pandas as pd

from vergence.eval.comparison.contestants import BOUND
from vergence.eval.comparison.statistics import Bootstrap, Interval, Statistic, mean, median, p95
from vergence.models.parts import FloatArray

_SETTLING: Final[dict[str, tuple[str, Statistic]]] = {
    "settled_2px_fraction": ("settled_2px", mean),
    "settle_2px_median_s": ("settle_2px_s", median),
    "settle_2px_p95_s": ("settle_2px_s", p95),
    "ratio_to_bound_2px_median": ("ratio_to_bound_2px", median),
    "ratio_to_bound_2px_p95": ("ratio_to_bound_2px", p95),
    "settled_fraction": ("settled", mean),
    "settle_1px_median_s": ("settle_1px_s", median),
    "settle_1px_p95_s": ("settle_1px_s", p95),
    "settle_05px_median_s": ("settle_05px_s", median),
    "settle_05px_p95_s": ("settle_05px_s", p95),
    "ratio_to_bound_median": ("ratio_to_bound", median),
    "ratio_to_bound_p95": ("ratio_to_bound", p95),
    "overshoot_median": ("overshoot", median),
    "overshoot_p95": ("overshoot", p95),
    "residual_px": ("residual_px", median),
    "residual_p95_px": ("residual_px", p95),
    "fix_error_settled_median_m": ("fix_error_settled_m", median),
}
_MOVING: Final[dict[str, tuple[str, Statistic]]] = {
    "tracking_rms_px": ("tracking_px", median),
    "tracking_rms_p95_px": ("tracking_px", p95),
    "tracking_lag_median_s": ("tracking_lag_s", median),
}
_BOTH: Final[dict[str, tuple[str, Statistic]]] = {
    "steady_median_px": ("steady_px", median),
    "steady_p95_px": ("steady_px", p95),
    "lost_fraction": ("lost", mean),
    "energy_median_rad2_s": ("energy_rad2_s", median),
    "peak_median_rad_s": ("peak_rad_s", median),
    "fix_error_end_median_m": ("fix_error_end_m", median),
    "fix_error_end_p95_m": ("fix_error_end_m", p95),
}
STATISTICS: Final = (*_SETTLING, *_MOVING, *_BOTH)
"""The names of all statistics, whatever kind of scenario has them."""


def settle_column(band_px: float) -> str:
    """The column of a trial's settling time in a band."""
    return f"settle_{band_px:g}px_s".replace(".", "")


def counted(table: pd.DataFrame) -> dict[str, FloatArray]:
    """The trials' values as summaries count them.

    Args:
        table: a row a trial, one controller's.

    Returns:
        (n,) values by column.
    """
    duration = table["duration_s"].to_numpy()
    values: dict[str, Any] = {
        name: table[name].to_numpy() for name in table.columns if table[name].dtype != object
    }
    values["settled"] = np.isfinite(values["settle_1px_s"])
    values["settled_2px"] = np.isfinite(values["settle_2px_s"])
    for band in ("", "_2px"):
        settle, bound = values[f"settle{band or '_1px'}_s"], values[f"bound{band}_s"]
        # where even the bound takes longer than the trial, nobody's ratio has a value, nor has
        # that of a trial that never settled
        never = (bound >= duration) | np.isnan(settle)
        ratio = settle / np.where(bound > 0.0, bound, np.nan)
        values[f"ratio_to_bound{band}"] = np.where(never & ~np.isnan(bound), np.inf, ratio)
    for name in ("settle_2px_s", "settle_1px_s", "settle_05px_s"):
        values[name] = np.where(np.isnan(values[name]), duration, values[name])
    # the fix at settling is that of the trial's end where it never settles
    settled = values["fix_error_settled_m"]
    end = values["fix_error_end_m"]
    known = np.isfinite(end).any()  # a plant without truth has no fix error at all
    end = np.where(np.isnan(end) & known, np.inf, end)
    values["fix_error_end_m"] = end
    values["fix_error_settled_m"] = np.where(np.isnan(settled), end, settled)
    return values


def summarise(table: pd.DataFrame, moving: bool, duration_s: float, seed: int) -> dict[str, Any]:
    """All statistics of one controller's trials.

    Args:
        table: a row a trial.
        moving: whether the scenario's target moves all along.
        duration_s: how long a trial lasts.
        seed: of the intervals' resampling.

    Returns:
        `trials`, `duration_s`, and each statistic by its name, its interval's ends by the name
        with `_low` and `_high`; nan where it has no meaning.
    """
    bootstrap = Bootstrap(len(table), seed)
    values = counted(table)
    row: dict[str, Any] = {"trials": len(table), "duration_s": duration_s}
    has = {**(_MOVING if moving else _SETTLING), **_BOTH}
    for name in STATISTICS:
        found = Interval(np.nan, np.nan, np.nan)
        if name in has:
            column, statistic = has[name]
            if not np.isnan(values[column]).any():
                found = bootstrap.interval(values[column], statistic)
        _put(row, name, found)
    return row


def compare(
    table: pd.DataFrame, reference: pd.DataFrame, moving: bool, band_px: float, seed: int
) -> dict[str, float]:
    """How many times faster than another controller on the same trials.

    Args:
        table: a row a trial.
        reference: the other controller's.
        moving: whether the scenario's target moves all along: then how many times nearer.
        band_px: the scenario's leading band of settling, px.
        seed: of the interval's resampling.

    Returns:
        `faster`, the ratio of the medians of settle time to that band (of tracking RMS for moving
        targets), the other's by this one's, and the ends of its interval; nan where less than
        half of the trials of either have settled, as there is no median then.
    """
    column = "tracking_px" if moving else settle_column(band_px)
    ours, theirs = counted(table)[column], counted(reference)[column]
    settled = moving or min(np.isfinite(one[column]).mean() for one in (table, reference)) > 0.5
    row: dict[str, float] = {}
    found = Interval(np.nan, np.nan, np.nan)
    if settled:
        with np.errstate(divide="ignore", invalid="ignore"):
            found = Bootstrap(len(ours), seed).ratio(theirs, ours, median)
    _put(row, "faster", found)
    return row


def bound_summary(table: pd.DataFrame, seed: int) -> dict[str, Any]:
    """The row of the time-optimal bound.

    Args:
        table: a row a trial, any controller's.
        seed: of the intervals' resampling.

    Returns:
        A row as `summarise` makes, with what the bound has.
    """
    limit = counted(table)
    bootstrap = Bootstrap(len(table), seed)
    row: dict[str, Any] = {name: table[name].iloc[0] for name in ("scenario", "plant")}
    row |= {"controller": BOUND, "options": {}, "trials": len(table)}
    row["duration_s"] = float(table["duration_s"].iloc[0])
    one = Interval(1.0, 1.0, 1.0)
    for name in STATISTICS:
        found = Interval(np.nan, np.nan, np.nan)
        if name.startswith("ratio_to_bound"):
            found = one
        elif name in ("settled_fraction", "settled_2px_fraction"):
            band = "bound_2px_s" if "2px" in name else "bound_s"
            found = bootstrap.interval(limit[band] < limit["duration_s"], mean)
        elif name.startswith(("settle_1px", "settle_2px")):
            band = "bound_2px_s" if "2px" in name else "bound_s"
            bound = np.minimum(limit[band], limit["duration_s"])
            found = bootstrap.interval(bound, median if name.endswith("median_s") else p95)
        _put(row, name, found)
    row["predict_us"] = row["predict_one_us"] = np.nan
    return row


def _put(row: dict[str, Any], name: str, interval: Interval) -> None:
    row[name], row[f"{name}_low"], row[f"{name}_high"] = interval
