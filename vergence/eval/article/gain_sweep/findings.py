"""What the gain sweep's table says: where overshoot begins, and which loops that fits."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from vergence.eval.article.gain_sweep.loop_delay import crossing
from vergence.eval.article.gain_sweep.trials import STEPS, GainSweepConfig
from vergence.models.files.head_file import load_head
from vergence.models.parts import FloatArray

ARTICLE_GAIN: Final = 4.0
"""The gain above which the article's system overshot, 1/s."""


@dataclass(frozen=True, kw_only=True)
class LoopFamily:
    """The loops whose overshoot begins at one gain."""

    gain: float
    """That gain, 1/s."""
    delays_frames: FloatArray
    """(n,) image delays, control periods."""
    lags_s: FloatArray
    """(n,) the lag that goes with each, s; nan where the delay alone is too long."""
    longest_delay_frames: float
    """The image delay of the family's member without a lag; nan if beyond those tried."""

    def delay_with(self, lag_s: float) -> float:
        """The image delay that goes with a lag, control periods; nan if beyond those tried."""
        return crossing(self.delays_frames, -self._filled(), -lag_s)

    def _filled(self) -> FloatArray:
        return np.where(np.isnan(self.lags_s), -1.0, self.lags_s)


def sweep(table: pd.DataFrame, step: str, plant: str = "kinematic") -> pd.DataFrame:
    """The trials with k1 = k2 of one step, by rising gain."""
    rows = table.query("case == 'sweep' and step == @step and plant == @plant")
    return rows.sort_values("k1_per_s")


def onsets(table: pd.DataFrame, config: GainSweepConfig) -> dict[str, float]:
    """The gain at which overshoot begins, by step, 1/s; nan if it does not in the sweep."""
    found = {}
    for step in STEPS:
        rows = sweep(table, step)
        found[step] = crossing(rows["k1_per_s"], rows["overshoot"], config.onset_fraction)
    return found


def at_gain(rows: pd.DataFrame, gain: float) -> "pd.Series[Any]":
    """The trial whose k2 is nearest to the wanted gain."""
    return rows.iloc[int(np.argmin(np.abs(rows["k2_per_s"].to_numpy() - gain)))]


def fastest(rows: pd.DataFrame) -> "pd.Series[Any]":
    """The trial that settles first to 1 px."""
    return rows.iloc[int(np.nanargmin(rows["settle_1px_s"].to_numpy()))]


def families(table: pd.DataFrame, config: GainSweepConfig) -> list[LoopFamily]:
    """The loops whose overshoot begins at each of the config's onset gains."""
    loops = table[table["case"] == "loop"]
    found = []
    for gain in config.onset_gains:
        of_gain = loops[loops["k1_per_s"] == gain]
        lags = [
            crossing(rows["lag_s"], rows["overshoot"], config.onset_fraction)
            for _, rows in of_gain.groupby("delay_frames")
        ]
        without = of_gain[of_gain["lag_s"] == 0.0].sort_values("delay_frames")
        delays = without["delay_frames"].to_numpy(dtype=np.float64)
        found.append(
            LoopFamily(
                gain=gain,
                delays_frames=delays,
                lags_s=np.array(lags),
                longest_delay_frames=crossing(delays, without["overshoot"], config.onset_fraction),
            )
        )
    return found


@dataclass(frozen=True, kw_only=True)
class Findings:
    """The numbers that the figures, the summary and the conclusion share."""

    onset: dict[str, float]
    """Gain at which overshoot begins, by step, 1/s."""
    families: list[LoopFamily]
    period_s: float
    """The head's control period."""
    latency_frames: int
    """The head's own image delay."""
    lag_s: float
    """The head's own lag."""
    dynamics_settle_s: float
    """Greatest difference of settle times to 1 px between the kinematic and mujoco plants."""
    dynamics_overshoot: float
    """The same of the overshoot, as a fraction of the step."""
    direction_settle_s: float
    """Greatest difference of settle times to 1 px between the steps along +y and -y."""


def find(table: pd.DataFrame, config: GainSweepConfig) -> Findings:
    """Read the table."""
    timing = load_head(config.head).timing
    settle, beyond = [0.0], [0.0]
    for step in STEPS:
        both = sweep(table, step).merge(sweep(table, step, "mujoco"), on="k1_per_s")
        for column, apart in (("settle_1px_s", settle), ("overshoot", beyond)):
            apart.extend((both[f"{column}_x"] - both[f"{column}_y"]).abs())
    down, up = (sweep(table, step)["settle_1px_s"].to_numpy() for step in ("+y", "-y"))
    directions = np.abs(down - up)
    return Findings(
        onset=onsets(table, config),
        families=families(table, config),
        period_s=timing.period_s,
        latency_frames=timing.latency_frames,
        lag_s=timing.lag_s,
        dynamics_settle_s=_greatest(settle),
        dynamics_overshoot=_greatest(beyond),
        direction_settle_s=_greatest(directions),
    )


def _greatest(values: ArrayLike) -> float:
    """The greatest number; nan if there is none."""
    known = np.asarray(values)
    known = known[np.isfinite(known)]
    return float(known.max()) if known.size else float("nan")
