"""Controllers compared on the same trials: every controller in every scenario on every plant.

```python
evaluation = evaluate(EvaluateConfig(controllers=("ibvs", "saccade"), scenarios=("workspace",)))
evaluation.rows()                       # what evaluation.json holds
evaluate(config, {"mine": my_policy})   # anything with Stable-Baselines3's predict
```
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import pandas as pd

from vergence.controllers.ibvs import IBVS
from vergence.envs.layout import ObservationLayout
from vergence.envs.plant import PLANTS
from vergence.envs.streams import as_seed
from vergence.errors import ConfigurationError, UnknownNameError
from vergence.eval.contestants import BASELINE, BOUND, Contestant, contestants, that_can_be_made
from vergence.eval.evaluation_summary import bound_summary, compare, summarise
from vergence.eval.jobs import Mapper, ProcessMapper, Progress, SerialMapper
from vergence.eval.scenarios import SCENARIOS, Scenario, load_scenario
from vergence.eval.trial_curves import effective_gains, error_curves, single_predict_us
from vergence.eval.trials import Trials, run_trials
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head

ROW: Final = (
    "scenario",
    "plant",
    "controller",
    "trials",
    "settled_fraction",
    "settle_1px_median_s",
    "settle_1px_p95_s",
    "ratio_to_bound_median",
    "ratio_to_bound_p95",
    "overshoot_median",
    "overshoot_p95",
    "lost_fraction",
    "tracking_rms_px",
    "predict_us",
)
"""The fields of a row of evaluation.json."""
OBSERVED: Final = 100
"""Trials whose observations serve the figures of gains and the cost for one head."""


@dataclass(frozen=True, kw_only=True)
class EvaluateConfig:
    """What to compare, and how."""

    controllers: tuple[str, ...] = ()
    """See `contestants`; none for all that can be made here."""
    scenarios: tuple[str, ...] = ("workspace",)
    """Names of scenarios."""
    plants: tuple[str, ...] = ("kinematic",)
    """What moves the heads."""
    episodes: int = 1000
    """Trials of each."""
    seed: int = 0
    """Seed of the trials, among the test seeds, and of the intervals' resampling."""
    head: str | None = None
    """A preset or TOML file in place of the scenarios' own heads."""
    workers: int = 1
    """Processes; the numbers are the same for any, but for the time that predict takes."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What one controller came to in one scenario on one plant."""

    scenario: str
    plant: str
    controller: str
    moving: bool
    duration_s: float
    options: dict[str, Any]
    """The options that it ran with."""
    trials: pd.DataFrame
    """A row a trial."""
    summary: dict[str, Any]
    """Every statistic with the ends of its interval, `_low` and `_high`; nan for no meaning."""
    curves: pd.DataFrame
    """See `error_curves`."""
    gains: pd.DataFrame
    """See `effective_gains`."""
    head: HeadModel


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """All outcomes."""

    config: EvaluateConfig
    outcomes: list[Outcome]
    notes: list[str] = field(default_factory=list)
    """What was left out, and why."""

    def summaries(self) -> list[dict[str, Any]]:
        """The rows of all tables: each scenario's and plant's controllers, and their bound."""
        rows = []
        for group in self.groups().values():
            reference = next((one for one in group if one.controller == BASELINE), None)
            for one in group:
                row = dict(one.summary)
                if reference is not None:
                    row |= compare(one.trials, reference.trials, one.moving, self.config.seed)
                rows.append(row)
            if not group[0].moving:
                rows.append(bound_summary(group[0].trials, self.config.seed))
        return rows

    def groups(self) -> dict[tuple[str, str], list[Outcome]]:
        """Outcomes by scenario and plant."""
        found: dict[tuple[str, str], list[Outcome]] = {}
        for one in self.outcomes:
            found.setdefault((one.scenario, one.plant), []).append(one)
        return found

    def rows(self) -> list[dict[str, Any]]:
        """The rows of evaluation.json: plain values, None where one has no meaning."""
        return [{key: plain_value(row.get(key)) for key in ROW} for row in self.summaries()]

    def trials(self) -> pd.DataFrame:
        """All trials, a row each."""
        return pd.concat([one.trials for one in self.outcomes], ignore_index=True)


def plain_value(value: Any) -> Any:
    """A value as JSON has it: None for nan and infinity."""
    if isinstance(value, float) and not abs(value) < float("inf"):
        return None
    return value


def evaluate(
    config: EvaluateConfig,
    others: Mapping[str, Any] | None = None,
    mapper: Mapper | None = None,
    progress: Progress | None = None,
) -> Evaluation:
    """Run every controller on every scenario's trials on every plant.

    Args:
        config: what to compare.
        others: more controllers by the names that tables shall call them: any object with
            Stable-Baselines3's `predict`.
        mapper: runs the jobs; by default as many processes as the config says.
        progress: told how many of the jobs are done.

    Returns:
        The evaluation.

    Raises:
        VergenceError: a name is unknown or an option has a value that cannot be.
    """
    as_seed(config.seed)
    if config.episodes < 1:
        raise ConfigurationError(f"episodes: expected at least 1, got {config.episodes}")
    head = None if config.head is None else load_head(config.head)
    scenarios = [_scenario(name) for name in dict.fromkeys(config.scenarios)]
    for plant in config.plants:
        if plant not in PLANTS:
            raise UnknownNameError("plant", plant, sorted(PLANTS))
    everyone: list[Contestant] = []
    notes: list[str] = []
    if config.controllers or not others:
        everyone = contestants(config.controllers)
    elif others:
        everyone = contestants((BASELINE,))
    everyone += [Contestant(label=name, source=one) for name, one in (others or {}).items()]
    pairs = []
    for scenario in scenarios:
        for plant in dict.fromkeys(config.plants):
            if plant in scenario.plants:
                pairs.append((scenario, plant))
            else:
                notes.append(
                    f"{scenario.name} on {plant} is left out: it runs on "
                    f"{', '.join(scenario.plants)}"
                )
    if not pairs:
        raise ConfigurationError(f"plant: expected one that a scenario runs on, got {notes[-1]}")
    named = {*config.controllers, *(others or {}), BASELINE}
    able = {}
    for scenario in {scenario.name: scenario for scenario, _ in pairs}.values():
        model = scenario.model() if head is None else head
        able[scenario.name], missing = that_can_be_made(everyone, model, scenario.name, named)
        notes += missing
    jobs = [
        _Job(contestant=one, scenario=scenario, plant=plant, head=head, config=config)
        for scenario, plant in pairs
        for one in able[scenario.name]
    ]
    if mapper is None:
        mapper = _mapper(min(config.workers, len(jobs)), progress)
    return Evaluation(config=config, outcomes=mapper(jobs), notes=list(dict.fromkeys(notes)))


def _mapper(workers: int, progress: Progress | None) -> Mapper:
    if workers == 1:
        return SerialMapper(progress)
    return ProcessMapper(workers, progress)


def _scenario(name: str) -> Scenario:
    if name not in SCENARIOS:
        raise UnknownNameError("scenario", name, list(SCENARIOS))
    return load_scenario(name)


@dataclass(frozen=True, kw_only=True)
class _Job:
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


def describe(options: Mapping[str, Any]) -> str:
    """A controller's options in one line."""
    if not options:
        return "its defaults"
    shown = {key: value for key, value in options.items() if key != "scenario"}
    return ", ".join(f"{key} {_short(value)}" for key, value in shown.items())


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def settings(config: EvaluateConfig) -> dict[str, Any]:
    """A config as plain values."""
    return dataclasses.asdict(config)


__all__ = [
    "BASELINE",
    "BOUND",
    "ROW",
    "EvaluateConfig",
    "Evaluation",
    "Outcome",
    "describe",
    "evaluate",
]
