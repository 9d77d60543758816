"""Controllers compared on the same trials: every controller in every scenario on every plant.

```python
evaluation = evaluate(EvaluateConfig(controllers=("ibvs", "saccade"), scenarios=("workspace",)))
evaluation.rows()                       # what evaluation.json holds
evaluate(config, {"mine": my_policy})   # anything with Stable-Baselines3's predict
```
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import pandas as pd

from vergence.controllers.controller import Controller
from vergence.controllers.ibvs import IBVS
from vergence.entry_points import is_entry_point
from vergence.envs.layout import ObservationLayout
from vergence.envs.plant import plant_type
from vergence.envs.streams import as_seed
from vergence.errors import ConfigurationError
from vergence.eval.comparison.config import EvaluateConfig
from vergence.eval.comparison.contestants import (
    BASELINE,
    BOUND,
    Contestant,
    contestants,
    that_can_be_made,
)
from vergence.eval.comparison.evaluation import ROW, Evaluation, Outcome
from vergence.eval.comparison.summary import summarise
from vergence.eval.jobs import Mapper, SerialMapper
from vergence.eval.trials.curves import effective_gains, error_curves, single_predict_us
from vergence.eval.trials.run import Trials, run_trials
from vergence.eval.trials.scenarios import Scenario, load_scenario
from vergence.models.files.head_file import load_head
from vergence.models.head import HeadModel

__all__ = [
    "BASELINE",
    "BOUND",
    "ROW",
    "EvaluateConfig",
    "Evaluation",
    "Outcome",
    "evaluate",
]


def evaluate(
    config: EvaluateConfig,
    others: Mapping[str, Controller] | None = None,
    mapper: Mapper | None = None,
) -> Evaluation:
    """Run every controller on every scenario's trials on every plant.

    Args:
        config: what to compare.
        others: more controllers by the names that tables shall call them: any object with
            Stable-Baselines3's `predict`.
        mapper: runs the jobs; this process by default. The numbers are the same for any mapper,
            but for the time that `predict` takes.

    Returns:
        The evaluation.

    Raises:
        VergenceError: a name is unknown or an option has a value that cannot be.
    """
    as_seed(config.seed)
    if config.episodes < 1:
        raise ConfigurationError(f"episodes: expected at least 1, got {config.episodes}")
    head = None if config.head is None else load_head(config.head)
    pairs, notes = _pairs(config)
    others = others or {}
    words = config.controllers or ((BASELINE,) if others else ())
    everyone = contestants(words)
    everyone += [Contestant(label=name, source=one) for name, one in others.items()]
    named = {*config.controllers, *others, BASELINE}
    able = {}
    for scenario in {scenario.name: scenario for scenario, _ in pairs}.values():
        model = scenario.model() if head is None else head
        able[scenario.name], missing = that_can_be_made(everyone, model, scenario.name, named)
        notes += missing
    jobs = [
        EvaluationJob(contestant=one, scenario=scenario, plant=plant, head=head, config=config)
        for scenario, plant in pairs
        for one in able[scenario.name]
    ]
    outcomes = (mapper or SerialMapper())(jobs)
    return Evaluation(config=config, outcomes=outcomes, notes=list(dict.fromkeys(notes)))


def _pairs(config: EvaluateConfig) -> tuple[list[tuple[Scenario, str]], list[str]]:
    """Each scenario with each plant that it runs on, and a note for each other plant."""
    scenarios = [load_scenario(name) for name in dict.fromkeys(config.scenarios)]
    for plant in config.plants:
        plant_type(plant)  # refuses what is no plant
    pairs, notes = [], []
    for scenario in scenarios:
        for plant in dict.fromkeys(config.plants):
            if plant in scenario.plants or is_entry_point(plant):
                pairs.append((scenario, plant))
            else:
                where = f"{scenario.name}, which runs on {', '.join(scenario.plants)}"
                notes.append(f"{plant} is left out of {where}")
    if not pairs:
        raise ConfigurationError(
            f"plant: expected one on which a scenario runs, got {plant} for {where}"
        )
    return pairs, notes


OBSERVED: Final = 100
"""Trials whose observations serve the figures of gains and the cost for one head."""


@dataclass(frozen=True, kw_only=True)
class EvaluationJob:
    """One controller in one scenario on one plant: what a worker does at a time; picklable.

    A thousand trials take seconds, and what comes back is small. Fewer trials a job would not
    share the work better: the whole ladder is a hundred jobs, and curves and intervals need all
    trials of a controller at one place.
    """

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


def _gain_of(controller: Controller) -> dict[str, Any]:
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
