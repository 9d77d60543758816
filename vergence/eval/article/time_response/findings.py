"""What the time response's table says: when our rig settles, and which loops need 650 ms."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

PAIRS: Final = ((0, False, 3.0), (4, True, 1.3))
"""Pairs of image delay and threshold (px) that should give the article's time, the second with
the head's own lag, the first without."""


@dataclass(frozen=True, kw_only=True)
class NamedPair:
    """A loop and threshold that should give the article's time."""

    delay_frames: int
    lag_s: float
    threshold_px: float
    settle_s: float
    """When the map's loop settles; nan where the map lacks it."""


@dataclass(frozen=True, kw_only=True)
class Findings:
    """The numbers that the figures, the summary and the conclusion share."""

    delay_frames: int
    """The head's own image delay."""
    lag_s: float
    """The head's own lag."""
    settle_s: dict[float, tuple[float, float]]
    """Least and greatest settle time of the noisy trials by threshold in px; nan if some trial
    does not settle."""
    trials: int
    pairs: list[NamedPair]
    offsets_deg: dict[str, float]
    """Offset of each joint of the eyes."""
    nominal_miss_px: tuple[float, float]
    """Least and greatest distance by coordinate of the nominal initial pixels from the
    article's."""
    step_px: tuple[float, float]
    """The initial error of the left and the right eye."""


def find(table: pd.DataFrame) -> Findings:
    """Read the table."""
    rig = table[table["case"] == "rig"]
    delay, lag = int(rig["delay_frames"].iloc[0]), float(rig["lag_s"].iloc[0])
    settle = {}
    for band, rows in rig.groupby("threshold_px"):
        times = rows["settle_s"].to_numpy()
        settle[float(str(band))] = (float(times.min()), float(times.max()))
    offsets = table[table["case"] == "offset"]
    initial = table[table["case"] == "initial"]
    miss = np.abs((initial["article_px"] - initial["nominal_px"]).to_numpy())
    trace = table[table["case"] == "trace"]
    first = trace[trace["time_s"] == 0.0]["error_px"].to_numpy()
    return Findings(
        delay_frames=delay,
        lag_s=lag,
        settle_s=settle,
        trials=int(rig["trial"].nunique()),
        pairs=[
            _pair(table, delay, lag if lagging else 0.0, band) for delay, lagging, band in PAIRS
        ],
        offsets_deg=dict(zip(offsets["joint"], offsets["offset_deg"], strict=True)),
        nominal_miss_px=(float(miss.min()), float(miss.max())),
        step_px=(float(first[0]), float(first[1])),
    )


def mapped(table: pd.DataFrame, lag_s: float) -> pd.DataFrame:
    """The map of one lag: settle time in s, a row a threshold, a column a delay."""
    rows = table[(table["case"] == "map") & (table["lag_s"] == lag_s)]
    return rows.pivot_table(
        index="threshold_px", columns="delay_frames", values="settle_s", dropna=False
    )


def held_by(table: pd.DataFrame, lag_s: float) -> pd.DataFrame:
    """The least thresholds that hold from the article's time on, by delay."""
    rows = table[(table["case"] == "by") & (table["lag_s"] == lag_s)]
    return rows.sort_values("delay_frames")


def _pair(table: pd.DataFrame, delay: int, lag_s: float, threshold_px: float) -> NamedPair:
    rows = table[
        (table["case"] == "map")
        & (table["lag_s"] == lag_s)
        & (table["delay_frames"] == delay)
        & ((table["threshold_px"] - threshold_px).abs() < 1e-6)
    ]
    settle = float(rows["settle_s"].iloc[0]) if len(rows) else np.nan
    return NamedPair(delay_frames=delay, lag_s=lag_s, threshold_px=threshold_px, settle_s=settle)
