"""One controller in one scenario on one plant: the unit of work of an evaluation."""

from dataclasses import dataclass
from typing import Any, Final

import pandas as pd

from vergence.controllers.ibvs import IBVS
from vergence.envs.layout import ObservationLayout
from vergence.eval.comparison.contestants import BASELINE, Contestant
from vergence.eval.comparison.evaluation import EvaluateConfig, Outcome
from vergence.eval.comparison.summary import summarise
from vergence.eval.trials.curves import effective_gains, error_curves, single_predict_us
from vergence.eval.trials.run import Trials, run_trials
from vergence.eval.trials.scenarios import Scenario
from vergence.models.head import HeadModel

OBSERVED: Final = 100
"""Trials whose observations serve the figures of gains and the cost for one head."""


@dataclass(frozen=True, kw_only=True)
class EvaluationJob:
    """One controller in one scenario on one plant; picklable."""

    contestant: Contestant
    scenario: Scenario
    plant: str
    head: HeadModel | None
    config: EvaluateConfig

    def __call__(self) -> Outcome:
        """Run it."""
        head = self.scenario.model() if self.head is None else self.head
        layout = ObservationLayout.of(head)
        controller, options = self.contestant.make(head, layout, self.scenario.name)
        if self.contestant.source in ("ibvs", BASELINE):
            options |= _gain_of(controller)
        trials = run_trials(
            controller,
            self.scenario,
            episodes=self.config.episodes,
            plant=self.plant,
            seed=self.config.seed,
            head=self.head,
            observed=OBSERVED,
        )
        table = _table(trials, self.contestant.label)
        summary = {
            "scenario": self.scenario.name,
            "plant": self.plant,
            "controller": self.contestant.label,
            "options": options,
            **summarise(table, trials.moving, trials.duration_s, self.config.seed),
            "predict_us": trials.predict_us,
            "predict_one_us": single_predict_us(controller, trials.observation),
        }
        return Outcome(
            scenario=self.scenario.name,
            plant=self.plant,
            controller=self.contestant.label,
            moving=trials.moving,
            duration_s=trials.duration_s,
            options=options,
            trials=table,
            summary=summary,
            curves=error_curves(trials),
            gains=effective_gains(trials, layout),
            head=head,
        )


def _gain_of(controller: Any) -> dict[str, Any]:
    """The constant gain of a law that has one, whether by option or by default."""
    if not isinstance(controller, IBVS):
        return {}
    gain = controller.gain
    return {"gain": float(gain.flat[0]) if (gain == gain.flat[0]).all() else gain.tolist()}


def _table(trials: Trials, label: str) -> pd.DataFrame:
    """A row a trial; nan for what has no meaning, and for a settle time that never came."""
    settling = not trials.moving
    nothing = float("nan")
    settle = trials.settle_s() if settling else nothing
    columns = {
        "scenario": trials.scenario,
        "plant": trials.plant,
        "controller": label,
        "trial": range(trials.num),
        "duration_s": trials.duration_s,
        "settle_1px_s": settle,
        "settle_05px_s": trials.settle_s(0.5) if settling else nothing,
        "bound_s": trials.bound_s,
        "ratio_to_bound": settle / trials.bound_s,
        "overshoot": trials.overshoot if settling else nothing,
        "steady_px": trials.steady_px,
        "lost": trials.lost,
        "energy_rad2_s": trials.energy,
        "peak_rad_s": trials.peak_rad_s,
        "tracking_px": trials.tracking_px if trials.moving else nothing,
        "tracking_lag_s": trials.tracking_lag_s if trials.moving else nothing,
        "fix_error_settled_m": trials.fix_error_at_settling_m() if settling else nothing,
        "fix_error_end_m": trials.fix_error_m[-1],
        **trials.conditions,
    }
    return pd.DataFrame(columns)
