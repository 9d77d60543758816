"""Results of the gain sweep: the gain at which overshoot begins, and the loops that explain it."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from vergence.eval.article.criterion import BY_CONSTRUCTION
from vergence.eval.article.experiment import SummaryRow
from vergence.eval.article.gain_sweep.loop_delay import first_crossing
from vergence.eval.article.gain_sweep.trials import PLANE_STEPS, STEPS, GainSweepConfig
from vergence.models.head_file import load_head
from vergence.models.parts import FloatArray
from vergence.reporting.text import Numbers

NAME: Final = "gain sweep"
ARTICLE_GAIN: Final = 4.0
"""Gain above which the article's system overshot, 1/s (physical: reported by the article)."""


@dataclass(frozen=True, kw_only=True)
class LoopFamily:
    """Loops, by image delay and lag, whose overshoot begins at one gain."""

    gain: float
    """Gain at which overshoot begins, 1/s."""
    delays_frames: FloatArray
    """(n,) image delays, control periods."""
    lags_s: FloatArray
    """(n,) lag of the loop with each delay, s; nan if the delay alone is too long."""
    longest_delay_frames: float
    """Image delay of the loop without a lag, control periods; nan if beyond those tried."""

    def delay_frames_at_lag(self, lag_s: float) -> float:
        """Image delay of the loop with a lag, control periods; nan if beyond those tried."""
        return first_crossing(self.delays_frames, -self._filled(), -lag_s)

    def _filled(self) -> FloatArray:
        return np.where(np.isnan(self.lags_s), -1.0, self.lags_s)


def sweep_trials(table: pd.DataFrame, step: str, plant: str = "kinematic") -> pd.DataFrame:
    """Trials of one step with k1 = k2, sorted by gain."""
    rows = table.query("case == 'sweep' and step == @step and plant == @plant")
    return rows.sort_values("k1_per_s")


def overshoot_onset_gains(table: pd.DataFrame, config: GainSweepConfig) -> dict[str, float]:
    """Gain at which overshoot begins, by step, 1/s; nan if it does not begin in the sweep."""
    found = {}
    for step in STEPS:
        rows = sweep_trials(table, step)
        found[step] = first_crossing(rows["k1_per_s"], rows["overshoot"], config.onset_fraction)
    return found


def trial_at_gain(rows: pd.DataFrame, gain: float) -> "pd.Series[Any]":
    """The trial whose k2 is nearest to the wanted gain."""
    return rows.iloc[int(np.argmin(np.abs(rows["k2_per_s"].to_numpy() - gain)))]


def fastest_trial(rows: pd.DataFrame) -> "pd.Series[Any]":
    """The trial with the shortest settling time to 1 px."""
    return rows.iloc[int(np.nanargmin(rows["settle_1px_s"].to_numpy()))]


def loop_families(table: pd.DataFrame, config: GainSweepConfig) -> list[LoopFamily]:
    """Loops whose overshoot begins at each of the config's onset gains."""
    loops = table[table["case"] == "loop"]
    found = []
    for gain in config.onset_gains:
        of_gain = loops[loops["k1_per_s"] == gain]
        lags = [
            first_crossing(rows["lag_s"], rows["overshoot"], config.onset_fraction)
            for _, rows in of_gain.groupby("delay_frames")
        ]
        without = of_gain[of_gain["lag_s"] == 0.0].sort_values("delay_frames")
        delays = without["delay_frames"].to_numpy(dtype=np.float64)
        found.append(
            LoopFamily(
                gain=gain,
                delays_frames=delays,
                lags_s=np.array(lags),
                longest_delay_frames=first_crossing(
                    delays, without["overshoot"], config.onset_fraction
                ),
            )
        )
    return found


@dataclass(frozen=True, kw_only=True)
class GainSweepFindings:
    """Results used by the figures, the summary and the text."""

    onset_gain_by_step: dict[str, float]
    """Gain at which overshoot begins, by step, 1/s."""
    families: list[LoopFamily]
    period_s: float
    """The head's control period, s."""
    latency_frames: int
    """The head's own image delay, control periods."""
    lag_s: float
    """The head's own lag, s."""
    plants_settle_difference_s: float
    """Largest difference of settling times to 1 px between the kinematic and mujoco plants, s."""
    plants_overshoot_difference: float
    """Largest difference of overshoots between these plants, as a fraction of the step."""
    directions_settle_difference_s: float
    """Largest difference of settling times to 1 px between the steps along +y and -y, s."""

    @property
    def delays_frames(self) -> list[float]:
        """Image delay of each family for the head's own lag, control periods."""
        return [family.delay_frames_at_lag(self.lag_s) for family in self.families]


def derive_findings(table: pd.DataFrame, config: GainSweepConfig) -> GainSweepFindings:
    """Derive the results from the table."""
    timing = load_head(config.head).timing
    settle, beyond = [0.0], [0.0]
    for step in STEPS:
        both = sweep_trials(table, step).merge(sweep_trials(table, step, "mujoco"), on="k1_per_s")
        for column, apart in (("settle_1px_s", settle), ("overshoot", beyond)):
            apart.extend((both[f"{column}_x"] - both[f"{column}_y"]).abs())
    down, up = (sweep_trials(table, step)["settle_1px_s"].to_numpy() for step in ("+y", "-y"))
    directions = np.abs(down - up)
    return GainSweepFindings(
        onset_gain_by_step=overshoot_onset_gains(table, config),
        families=loop_families(table, config),
        period_s=timing.period_s,
        latency_frames=timing.latency_frames,
        lag_s=timing.lag_s,
        plants_settle_difference_s=_greatest(settle),
        plants_overshoot_difference=_greatest(beyond),
        directions_settle_difference_s=_greatest(directions),
    )


def _greatest(values: ArrayLike) -> float:
    """Largest finite value; nan if there is none."""
    known = np.asarray(values)
    known = known[np.isfinite(known)]
    return float(known.max()) if known.size else float("nan")


def numbers(table: pd.DataFrame, config: GainSweepConfig) -> Numbers:
    """The numbers of the text."""
    found, rows = derive_findings(table, config), sweep_trials(table, "-y")
    slow, reached, best = rows.iloc[0], trial_at_gain(rows, ARTICLE_GAIN), fastest_trial(rows)
    plane = table[table["case"] == "plane"]
    plane = plane[plane["k2_per_s"] == trial_at_gain(plane, ARTICLE_GAIN)["k2_per_s"]]
    onsets = list(found.onset_gain_by_step.values())
    filled: dict[str, float] = {
        "article_gain": ARTICLE_GAIN,
        "least_gain": slow["k1_per_s"],
        "least_gain_settle_s": slow["settle_1px_s"],
        "article_gain_settle_s": reached["settle_1px_s"],
        "article_gain_settle_05px_s": reached["settle_05px_s"],
        "fastest_gain": best["k1_per_s"],
        "fastest_settle_s": best["settle_1px_s"],
        "fastest_overshoot_percent": 100.0 * best["overshoot"],
        "directions_apart_ms": 1000.0 * found.directions_settle_difference_s,
        "dynamics_apart_ms": 1000.0 * found.plants_settle_difference_s,
        "dynamics_overshoot_apart_percent": 100.0 * found.plants_overshoot_difference,
        "plane_k2": plane["k2_per_s"].iloc[0],
        "plane_k1_low": plane["k1_per_s"].min(),
        "plane_k1_high": plane["k1_per_s"].max(),
        "onset_percent": 100.0 * config.onset_fraction,
        "onset_low": float(np.min(onsets)),
        "onset_high": float(np.max(onsets)),
        "period_ms": 1000.0 * found.period_s,
        "latency_frames": found.latency_frames,
        "lag_ms": 1000.0 * found.lag_s,
        "theory_delay_ms": 1000.0 / (np.e * ARTICLE_GAIN),
        "theory_lag_ms": 1000.0 / (4.0 * ARTICLE_GAIN),
    }
    for step, name in zip(PLANE_STEPS, ("y", "xy"), strict=True):
        settle = plane[plane["step"] == step]["settle_1px_s"]
        filled[f"plane_{name}_change_ms"] = 1000.0 * (settle.max() - settle.min())
    for end, family, frames in zip(
        ("low", "high"), found.families, found.delays_frames, strict=True
    ):
        filled[f"loops_{end}_gain"] = family.gain
        filled[f"loops_{end}_delay_ms"] = 1000.0 * found.period_s * family.longest_delay_frames
        filled[f"loops_{end}_lag_ms"] = 1000.0 * family.lags_s[0]
        filled[f"loops_{end}_frames"] = frames
    return {name: float(value) for name, value in filled.items()}


def summarise(table: pd.DataFrame, config: GainSweepConfig) -> list[SummaryRow]:
    """Rows of the summary: our figures beside the article's only one, and further figures of ours.

    Verdicts beyond those of `verdict_of_ranges`: `inside` if our rig's delay lies between those of
    the identified loops, else `outside`; `target met` if the settling time never rises with the
    gain up to the article's, else `target missed`.
    """
    found = derive_findings(table, config)
    rows = []
    for axis, steps in (("y", ("+y", "-y")), ("x", ("+x", "-x"))):
        gains = [found.onset_gain_by_step[step] for step in steps]
        onset = (float(np.min(gains)), float(np.max(gains)))
        # the preset's image delay was chosen for an onset just above the article's gain
        verdict = BY_CONSTRUCTION if np.isfinite(onset).all() else None
        quantity = "gain at which overshoot begins"
        rows.append(_row(quantity, axis, "1/s", onset, ARTICLE_GAIN, verdict))
        for gain in (sweep_trials(table, "+y")["k1_per_s"].min(), ARTICLE_GAIN):
            settled = [
                trial_at_gain(sweep_trials(table, step), gain)["settle_1px_s"] for step in steps
            ]
            quantity = f"settle time to 1 px at k = {gain:g}"
            rows.append(_row(quantity, axis, "s", (min(settled), max(settled))))
    best = [float(fastest_trial(sweep_trials(table, step))["k1_per_s"]) for step in ("+y", "-y")]
    rows.append(_row("fastest gain", "y", "1/s", (min(best), max(best))))
    low, high = float(np.min(found.delays_frames)), float(np.max(found.delays_frames))
    period_ms = 1000.0 * found.period_s
    quantity = f"image delay identified with a lag of {1000.0 * found.lag_s:g} ms"
    verdict = "inside" if low <= found.latency_frames <= high else "outside"
    rows.append(
        _row(quantity, "y", "ms", (period_ms * low, period_ms * high), None,
             verdict if np.isfinite([low, high]).all() else "none")
    )  # fmt: skip
    up_to = sweep_trials(table, "-y").query("k1_per_s <= @ARTICLE_GAIN + 1e-9")["settle_1px_s"]
    rise = float(up_to.diff().max())
    quantity = f"greatest rise of the settle time from gain to gain up to k = {ARTICLE_GAIN:g}"
    verdict = "target met" if rise <= 0.0 else "target missed"
    return [*rows, _row(f"{quantity}, target 0 s", "y", "s", (rise, rise), None, verdict)]


def _row(
    quantity: str, axis: str, unit: str, ours: tuple[float, float], article: float | None = None,
    verdict: str | None = None,
) -> SummaryRow:  # fmt: skip
    return SummaryRow.of(NAME, quantity, "ibvs", axis, article, ours, verdict, unit)
