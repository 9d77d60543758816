"""Results of the time response: settling times of our rig, and the loops that need 650 ms."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from vergence.eval.article.experiment import SummaryRow
from vergence.eval.article.time_response.trials import ARTICLE_S, TimeResponseConfig
from vergence.models.head_file import load_head
from vergence.reporting.text import Numbers

NAME: Final = "time response"
PAIRS: Final = ((0, False, 3.0), (4, True, 1.3))
"""Loops that should give the article's time: image delay (control periods), true for the head's own
lag and false for none, settling threshold (px)."""


@dataclass(frozen=True, kw_only=True)
class LoopAndThreshold:
    """A loop and a settling threshold that should give the article's time."""

    delay_frames: int
    lag_s: float
    threshold_px: float
    settle_s: float
    """Settling time of this loop in the map, s; nan if the map lacks it."""


@dataclass(frozen=True, kw_only=True)
class TimeResponseFindings:
    """Results used by the figures, the summary and the text."""

    delay_frames: int
    """The head's own image delay, control periods."""
    lag_s: float
    """The head's own lag, s."""
    settle_s: dict[float, tuple[float, float]]
    """Least and greatest settling time of the noisy trials, s, by threshold in px; nan if some
    trial does not settle."""
    trials: int
    pairs: list[LoopAndThreshold]
    offsets_deg: dict[str, float]
    """Offset of each eye joint, degrees."""
    nominal_difference_px: tuple[float, float]
    """Least and greatest absolute difference, by coordinate, of the nominal initial pixels from
    the article's, px."""
    step_px: tuple[float, float]
    """Initial pixel error of the left and the right eye, px."""


def derive_findings(table: pd.DataFrame) -> TimeResponseFindings:
    """Derive the results from the table."""
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
    return TimeResponseFindings(
        delay_frames=delay,
        lag_s=lag,
        settle_s=settle,
        trials=int(rig["trial"].nunique()),
        pairs=[
            _pair(table, delay, lag if lagging else 0.0, band) for delay, lagging, band in PAIRS
        ],
        offsets_deg=dict(zip(offsets["joint"], offsets["offset_deg"], strict=True)),
        nominal_difference_px=(float(miss.min()), float(miss.max())),
        step_px=(float(first[0]), float(first[1])),
    )


def settle_time_map(table: pd.DataFrame, lag_s: float) -> pd.DataFrame:
    """Map of one lag: settling time in s, a row per threshold, a column per delay."""
    rows = table[(table["case"] == "map") & (table["lag_s"] == lag_s)]
    return rows.pivot_table(
        index="threshold_px", columns="delay_frames", values="settle_s", dropna=False
    )


def held_thresholds_px(table: pd.DataFrame, lag_s: float) -> pd.DataFrame:
    """Least threshold within which the error stays from the article's time on, by delay."""
    rows = table[(table["case"] == "by") & (table["lag_s"] == lag_s)]
    return rows.sort_values("delay_frames")


def _pair(table: pd.DataFrame, delay: int, lag_s: float, threshold_px: float) -> LoopAndThreshold:
    rows = table[
        (table["case"] == "map")
        & (table["lag_s"] == lag_s)
        & (table["delay_frames"] == delay)
        & ((table["threshold_px"] - threshold_px).abs() < 1e-6)
    ]
    settle = float(rows["settle_s"].iloc[0]) if len(rows) else np.nan
    return LoopAndThreshold(
        delay_frames=delay, lag_s=lag_s, threshold_px=threshold_px, settle_s=settle
    )


def summarise(table: pd.DataFrame, config: TimeResponseConfig) -> list[SummaryRow]:
    """Rows of the summary: our settling times beside the article's 650 ms, and joint offsets."""
    del config
    found = derive_findings(table)
    article = 1000.0 * ARTICLE_S
    rows = []
    for band, (low_s, high_s) in sorted(found.settle_s.items(), reverse=True):
        ours = (1000.0 * low_s, 1000.0 * high_s)
        what = f"settle time to {band:g} px"
        rows.append(SummaryRow.of(NAME, what, "ibvs", "both eyes", article, ours, unit="ms"))
    for pair in found.pairs:
        what = (
            f"settle time to {pair.threshold_px:g} px with {pair.delay_frames} frames of delay and "
            f"{1000.0 * pair.lag_s:g} ms of lag"
        )
        settle = 1000.0 * pair.settle_s
        rows.append(SummaryRow.of(NAME, what, "ibvs", "both eyes", article, settle, unit="ms"))
    for joint, offset in found.offsets_deg.items():
        rows.append(SummaryRow.of(NAME, "joint offset", "ibvs", joint, None, offset, unit="deg"))
    return rows


def numbers(table: pd.DataFrame, config: TimeResponseConfig) -> Numbers:
    """The numbers of the text."""
    found = derive_findings(table)
    without, with_delay = found.pairs
    (low_1, high_1), (low_05, high_05) = found.settle_s[1.0], found.settle_s[0.5]
    return {
        "article_ms": 1000.0 * ARTICLE_S,
        "trials": found.trials,
        "delay_frames": found.delay_frames,
        "lag_ms": 1000.0 * found.lag_s,
        "latency_ms": 1000.0 * found.delay_frames * load_head(config.head).timing.period_s,
        "settle_1px_low_ms": 1000.0 * low_1,
        "settle_1px_high_ms": 1000.0 * high_1,
        "settle_05px_low_ms": 1000.0 * low_05,
        "settle_05px_high_ms": 1000.0 * high_05,
        "without_delay_threshold_px": without.threshold_px,
        "without_delay_settle_ms": 1000.0 * without.settle_s,
        "with_delay_frames": with_delay.delay_frames,
        "with_delay_threshold_px": with_delay.threshold_px,
        "with_delay_settle_ms": 1000.0 * with_delay.settle_s,
        "miss_low_px": found.nominal_difference_px[0],
        "miss_high_px": found.nominal_difference_px[1],
        "step_left_px": found.step_px[0],
        "step_right_px": found.step_px[1],
        **{f"{joint}_deg": offset for joint, offset in found.offsets_deg.items()},
    }
