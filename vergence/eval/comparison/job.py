"""The evaluation's job: trials and statistics of one controller in one scenario on one plant."""

from dataclasses import dataclass
from typing import Any, Final

import pandas as pd

from vergence.controllers.controller import Controller
from vergence.controllers.ibvs import IBVS
from vergence.controllers.tuned_ibvs import TunedIBVS
from vergence.eval.comparison.contestant_job import ContestantJob, MadeController
from vergence.eval.comparison.contestants import BASELINE
from vergence.eval.comparison.evaluation import EvaluationResult
from vergence.eval.comparison.summary import trial_statistics
from vergence.eval.trials.curves import (
    effective_gain_table,
    error_quantile_table,
    single_predict_us,
)
from vergence.eval.trials.results import Trials
from vergence.eval.trials.settling import bands_with_bound, bands_with_settle_time

OBSERVED: Final = 100
"""Trials whose observations are kept, for effective gains and the duration of `predict` for one
head (chosen: memory against samples)."""


@dataclass(frozen=True, kw_only=True)
class EvaluationJob(ContestantJob[EvaluationResult]):
    """Run and summarise all trials of one controller in one scenario on one plant.

    A thousand trials take seconds, and the result is small. Smaller jobs would not balance the load
    better: all controllers make a hundred jobs, and curves and intervals need all trials of a
    controller in one process.
    """

    def _evaluate(self, made: MadeController) -> EvaluationResult:
        controller, options, head, layout = made
        if self.contestant.source in ("ibvs", BASELINE):
            options |= _gain_of(controller)
        trials = self._trials(controller, self.scenario, observed_trials=OBSERVED)
        table = _table(trials, self.contestant.label)
        summary = {
            "scenario": self.scenario.name,
            "plant": self.plant,
            "controller": self.contestant.label,
            "head": head.name,
            "options": options,
            "tuned": self.resolved.tuned,
            "tuned_for": self.resolved.tuned_for,
            "given": list(self.resolved.given_names),
            **trial_statistics(
                table, trials.target_moves, trials.duration_s, trials.band_px, self.seed
            ),
            "predict_us": trials.predict_us,
            "predict_one_us": single_predict_us(controller, trials.observation),
        }
        return EvaluationResult(
            scenario=self.scenario.name,
            plant=self.plant,
            controller=self.contestant.label,
            target_moves=trials.target_moves,
            band_px=trials.band_px,
            duration_s=trials.duration_s,
            options=options,
            tuned=self.resolved.tuned,
            given=self.resolved.given_names,
            trials=table,
            summary=summary,
            curves=error_quantile_table(trials),
            effective_gains=effective_gain_table(trials, layout),
            head=head,
        )


def _gain_of(controller: Controller) -> dict[str, Any]:
    """The constant gain of a law that has one, given as an option or by default."""
    if not isinstance(controller, IBVS | TunedIBVS):
        return {}
    gain = controller.gain
    return {"gain": float(gain.flat[0]) if (gain == gain.flat[0]).all() else gain.tolist()}


def _table(trials: Trials, label: str) -> pd.DataFrame:
    """Table with one row per trial; nan for undefined metrics and trials that never settle."""
    settling = not trials.target_moves
    nothing = float("nan")
    judged = bands_with_bound(trials.band_px)
    columns = {
        "scenario": trials.scenario,
        "plant": trials.plant,
        "controller": label,
        "trial": range(trials.num),
        "duration_s": trials.duration_s,
        **{
            band.settle_s_column: trials.settle_s(band.px) if settling else nothing
            for band in reversed(bands_with_settle_time(trials.band_px))
        },
        **{band.bound_s_column: trials.bounds_s[band.px] for band in judged},
        **{
            band.ratio_column: trials.ratio_to_bound(band.px) if settling else nothing
            for band in judged
        },
        "overshoot": trials.overshoot if settling else nothing,
        "steady_px": trials.steady_px,
        "residual_px": trials.residual_px,
        "lost": trials.lost,
        "left_again": trials.left_again if settling else nothing,
        "swings": trials.swings if settling else nothing,
        "fixation_rms_rad_s": trials.fixation_rms_rad_s,
        "fixation_peak_to_peak_rad_s": trials.fixation_peak_to_peak_rad_s,
        "energy_rad2_s": trials.energy,
        "peak_rad_s": trials.peak_rad_s,
        "tracking_px": trials.tracking_px if trials.target_moves else nothing,
        "tracking_lag_s": trials.tracking_lag_s if trials.target_moves else nothing,
        "fix_error_settled_m": trials.fix_error_at_settling_m() if settling else nothing,
        "fix_error_end_m": trials.fix_error_m[-1],
        **trials.conditions,
    }
    return pd.DataFrame(columns)
